"""A ROS 2 node as rmw_zenoh makes one, with its router: `PORT COUNT`. It says `ready`, hears COUNT messages, says `heard`, is told the file of attitudes
on standard input (ours, east-north-up and right-forward-up), and says in one line of JSON what it found.
"""

import json
import math
import os
import queue
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore

port, count = int(sys.argv[1]), int(sys.argv[2])
store = get_typestore(Stores.ROS2_JAZZY)
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
came, tokens = queue.Queue(), []
kept = [
    session.declare_subscriber("7/imu/data/**", came.put),
    session.liveliness().declare_subscriber("@ros2_lv/7/**", lambda it: tokens.append((str(it.kind).split(".")[-1], str(it.key_expr)))),
]
print("ready", flush=True)
samples = [came.get(timeout=60) for _ in range(count)]
print("heard", flush=True)
out = sys.stdin.readline().strip()
for _ in range(1000):
    if len(tokens) == 4:
        break
    time.sleep(0.01)


def product(a, b):
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


# Forward, left, up is right, forward, up turned by 90° about up.
QUARTER = (math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4))
with open(out) as lines:
    next(lines)
    ours = [product(tuple(map(float, line.split(",")[1:])), QUARTER) for line in lines]


def apart(a, b):
    return min(max(abs(x - s * y) for x, y in zip(a, b)) for s in (1, -1))


rows, furthest, fastest, rate_off, stamps, numbers, forces, covariances, whole = [], 0, 0, 0, [], [], [], [], True
for sample in samples:
    data = bytes(sample.payload)
    imu = store.deserialize_cdr(data, "sensor_msgs/msg/Imu")
    whole &= bytes(store.serialize_cdr(imu, "sensor_msgs/msg/Imu")) == data and imu.header.frame_id == "body"
    q = (imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z)
    row = min(range(len(ours)), key=lambda i: apart(q, ours[i])) if not rows else min(rows[-1] + 10, len(ours) - 1)
    rows.append(row)
    furthest = max(furthest, apart(q, ours[row]))
    stamps.append(imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec)
    w, x, y, z = product((ours[row - 1][0], *(-part for part in ours[row - 1][1:])), ours[row])
    rate, said = [2000 * part / w for part in (x, y, z)], imu.angular_velocity
    fastest = max(fastest, *map(abs, rate))
    rate_off = max(rate_off, *(abs(a - b) for a, b in zip(rate, (said.x, said.y, said.z))))
    a = imu.linear_acceleration
    forces.append(math.sqrt(a.x**2 + a.y**2 + a.z**2))
    c = imu.orientation_covariance
    covariances.append(c[0] > 0 and c[0] == c[4] and c[8] > 0)
    beside = bytes(sample.attachment)
    numbers.append((int.from_bytes(beside[:8], "little"), int.from_bytes(beside[8:16], "little"), beside[16], beside[17:].hex(), len(beside)))

print(json.dumps({
    "hash": store.hash_rihs01("sensor_msgs/msg/Imu"), "key": str(samples[0].key_expr), "tokens": tokens, "whole": bool(whole),
    "furthest": furthest, "fastest_rad_s": fastest, "rate_off_rad_s": rate_off,
    "force_m_s2": sum(forces) / len(forces), "covariances": bool(all(covariances)),
    "numbers_follow": all(b[0] == a[0] + 1 for a, b in zip(numbers, numbers[1:])), "sender": [numbers[0][2], len({n[3] for n in numbers}), numbers[0][4]],
    "late_s": max(n[1] - s for n, s in zip(numbers, stamps)) / 1e9, "early_s": min(n[1] - s for n, s in zip(numbers, stamps)) / 1e9,
    "step_ms": (stamps[-1] - stamps[0]) / (len(stamps) - 1) / 1e6,
}), flush=True)
# Zenoh's threads would hold up an interpreter that ends.
os._exit(0)
