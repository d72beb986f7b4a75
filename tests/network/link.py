"""A network link between two namespaces that delays packets and loses some: two TUN devices, and what goes from one to the other.

    link.py NAMESPACE ADDRESS/BITS NAMESPACE ADDRESS/BITS

Packets are the kernel's own, so what TCP makes of delay and loss is what it makes of them in the field. Each line `DELAY_S LOSS` on standard
input sets both directions from then on; the answer is a line of JSON: packets that went through and that were lost before. It ends with
its input.
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
PACKETS_MAX = 20_000
PACKET_BYTES_MAX = 65_536
LOOK_LIMIT_S = 0.5

# linux/if_tun.h and linux/sched.h
TUNSETIFF = 0x400454CA
IFF_TUN = 0x0001
IFF_NO_PI = 0x1000
CLONE_NEWNET = 0x40000000


def device(namespace: str, address: str) -> int:
    """The descriptor of a device with this address in a namespace."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/run/netns/{namespace}") as place:
        if libc.setns(place.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"entering the namespace {namespace}")
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI))
    for arguments in (["address", "add", address, "dev", DEVICE], ["link", "set", DEVICE, "up"], ["link", "set", "lo", "up"]):
        subprocess.run(["ip", *arguments], check=True)
    return descriptor


class Direction:
    """Packets from one device on their way to the other."""

    def __init__(self, source: int, sink: int):
        self.source, self.sink = source, sink
        self.under_way = deque()
        self.through = self.lost = 0

    def take(self, delay_s: float, loss: float):
        for _ in range(PACKETS_MAX):
            try:
                packet = os.read(self.source, PACKET_BYTES_MAX)
            except OSError:  # there is none, or the device is down
                return
            if random.random() < loss or len(self.under_way) >= PACKETS_MAX:
                self.lost += 1
            else:
                self.under_way.append((time.monotonic() + delay_s, packet))

    def give(self):
        while self.under_way and self.under_way[0][0] <= time.monotonic():
            _, packet = self.under_way.popleft()
            try:
                os.write(self.sink, packet)
                self.through += 1
            except OSError:  # the device is down, or full
                self.lost += 1

    def wait_s(self) -> float:
        return max(0.0, self.under_way[0][0] - time.monotonic()) if self.under_way else LOOK_LIMIT_S


def main():
    one, other = device(sys.argv[1], sys.argv[2]), device(sys.argv[3], sys.argv[4])
    directions = [Direction(one, other), Direction(other, one)]
    delay_s, loss = 0.0, 0.0
    print("{}", flush=True)
    while True:
        ready, _, _ = select.select([sys.stdin, one, other], [], [], min(it.wait_s() for it in directions))
        for direction in directions:
            direction.take(delay_s, loss)
            direction.give()
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            delay_s, loss = map(float, line.split())
            print(json.dumps({"through": [it.through for it in directions], "lost": [it.lost for it in directions]}), flush=True)


main()
