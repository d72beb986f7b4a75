"""Network link between two namespaces that delays and drops packets, built from two TUN devices.

    link.py NAMESPACE ADDRESS/BITS NAMESPACE ADDRESS/BITS

The packets come from the kernel, so TCP reacts to delay and loss as in the field.
Input: lines `DELAY_S LOSS` on standard input, which apply to both directions from then on.
Output: `{}` when the link is ready, then for each input line a line of JSON with the numbers of
packets delivered and lost so far.
The program exits at the end of its input.
"""

import ctypes
import fcntl
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from collections import deque

DEVICE = "wire"
MAX_QUEUED_PACKETS = 20_000
MAX_PACKET_BYTES = 65_536
MAX_WAIT_S = 0.5

# linux/if_tun.h and linux/sched.h
TUNSETIFF = 0x400454CA
IFF_TUN = 0x0001
IFF_NO_PI = 0x1000
CLONE_NEWNET = 0x40000000


def open_device(namespace: str, address: str) -> int:
    """Creates a TUN device with this address in a namespace and returns its descriptor."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/run/netns/{namespace}") as namespace_file:
        if libc.setns(namespace_file.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"cannot enter the namespace {namespace}")
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI))
    for arguments in (["address", "add", address, "dev", DEVICE], ["link", "set", DEVICE, "up"], ["link", "set", "lo", "up"]):
        subprocess.run(["ip", *arguments], check=True)
    return descriptor


class Direction:
    """Packets in transit from one device to the other."""

    def __init__(self, source: int, sink: int):
        self.source, self.sink = source, sink
        self.in_transit = deque()
        self.delivered = self.lost = 0

    def read_packets(self, delay_s: float, loss: float):
        for _ in range(MAX_QUEUED_PACKETS):
            try:
                packet = os.read(self.source, MAX_PACKET_BYTES)
            except OSError:  # there is none, or the device is down
                return
            if random.random() < loss or len(self.in_transit) >= MAX_QUEUED_PACKETS:
                self.lost += 1
            else:
                self.in_transit.append((time.monotonic() + delay_s, packet))

    def write_packets(self):
        while self.in_transit and self.in_transit[0][0] <= time.monotonic():
            _, packet = self.in_transit.popleft()
            try:
                os.write(self.sink, packet)
                self.delivered += 1
            except OSError:  # the device is down, or full
                self.lost += 1

    def wait_s(self) -> float:
        return max(0.0, self.in_transit[0][0] - time.monotonic()) if self.in_transit else MAX_WAIT_S


def main():
    first, second = open_device(sys.argv[1], sys.argv[2]), open_device(sys.argv[3], sys.argv[4])
    directions = [Direction(first, second), Direction(second, first)]
    delay_s, loss = 0.0, 0.0
    print("{}", flush=True)
    while True:
        ready, _, _ = select.select([sys.stdin, first, second], [], [], min(direction.wait_s() for direction in directions))
        for direction in directions:
            direction.read_packets(delay_s, loss)
            direction.write_packets()
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            delay_s, loss = map(float, line.split())
            print(json.dumps({"delivered": [direction.delivered for direction in directions], "lost": [direction.lost for direction in directions]}), flush=True)


main()
