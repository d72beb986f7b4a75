"""ROS 2 node that receives attitudes, with its own rmw_zenoh router: PORT COUNT TRANSFORMS FIELDS.

Prints `ready`, receives COUNT attitudes, TRANSFORMS transforms, FIELDS magnetic fields and two
diagnostic messages, and prints `received`. Then it reads the path of an attitude
file (written by `plumb up --out`: east-north-up, right-forward-up) from standard input and prints
the comparison as one line of JSON.
"""

import json
import math
import os
import queue
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore

port, count, transform_count, field_count = map(int, sys.argv[1:])
store = get_typestore(Stores.ROS2_JAZZY)
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
received, transforms, fields, diagnostics = (queue.Queue() for _ in range(4))
tokens = []
subscriptions = [
    session.declare_subscriber("7/imu/data/**", received.put),
    session.declare_subscriber("7/tf/**", transforms.put),
    session.declare_subscriber("7/imu/mag/**", fields.put),
    session.declare_subscriber("7/diagnostics/**", diagnostics.put),
    session.liveliness().declare_subscriber("@ros2_lv/7/**", lambda it: tokens.append((str(it.kind).split(".")[-1], str(it.key_expr)))),
]
print("ready", flush=True)
samples = [received.get(timeout=60) for _ in range(count)]
transforms = [transforms.get(timeout=60) for _ in range(transform_count)]
fields = [fields.get(timeout=60) for _ in range(field_count)]
diagnostics = [diagnostics.get(timeout=60) for _ in range(2)]
print("received", flush=True)
out = sys.stdin.readline().strip()
for _ in range(1000):
    if sum(kind == "DELETE" for kind, _ in tokens) == (5 if transform_count else 4):
        break
    time.sleep(0.01)


def product(a, b):
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


# The body frame of ROS is forward, left, up: Plumbline's frame rotated by 90° about the up axis.
QUARTER = (math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4))
with open(out) as lines:
    next(lines)
    expected = [product(tuple(map(float, line.split(",")[1:])), QUARTER) for line in lines]


def difference(a, b):
    return min(max(abs(x - s * y) for x, y in zip(a, b)) for s in (1, -1))


rows, max_difference, fastest, rate_error, stamps, numbers, forces, covariances, complete = [], 0, 0, 0, [], [], [], [], True
for sample in samples:
    data = bytes(sample.payload)
    imu = store.deserialize_cdr(data, "sensor_msgs/msg/Imu")
    complete &= bytes(store.serialize_cdr(imu, "sensor_msgs/msg/Imu")) == data and imu.header.frame_id == "body"
    q = (imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z)
    row = min(range(len(expected)), key=lambda i: difference(q, expected[i])) if not rows else min(rows[-1] + 10, len(expected) - 1)
    rows.append(row)
    max_difference = max(max_difference, difference(q, expected[row]))
    stamps.append(imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec)
    w, x, y, z = product((expected[row - 1][0], *(-part for part in expected[row - 1][1:])), expected[row])
    rate, published = [2000 * part / w for part in (x, y, z)], imu.angular_velocity
    fastest = max(fastest, *map(abs, rate))
    rate_error = max(rate_error, *(abs(a - b) for a, b in zip(rate, (published.x, published.y, published.z))))
    a = imu.linear_acceleration
    forces.append(math.sqrt(a.x**2 + a.y**2 + a.z**2))
    c = imu.orientation_covariance
    covariances.append(c[0] > 0 and c[0] == c[4] and c[8] > 0)
    attachment = bytes(sample.attachment)
    numbers.append((int.from_bytes(attachment[:8], "little"), int.from_bytes(attachment[8:16], "little"), attachment[16], attachment[17:].hex(), len(attachment)))

TYPES = {"tf": "tf2_msgs/msg/TFMessage", "mag": "sensor_msgs/msg/MagneticField", "diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}


def decoded(samples, kind):
    """Decodes messages, and reports their key, publisher and whether they encode to the same bytes."""
    messages, same = [], True
    for sample in samples:
        data = bytes(sample.payload)
        messages.append(store.deserialize_cdr(data, TYPES[kind]))
        same &= bytes(store.serialize_cdr(messages[-1], TYPES[kind])) == data
    attachments = [bytes(sample.attachment) for sample in samples]
    sequence = [int.from_bytes(attachment[:8], "little") for attachment in attachments]
    return messages, {
        "key": str(samples[0].key_expr), "hash": store.hash_rihs01(TYPES[kind]), "complete": same,
        "numbers_follow": all(b == a + 1 for a, b in zip(sequence, sequence[1:])), "gids": sorted({a[17:].hex() for a in attachments}),
    }


def stamp_ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def turned(q, v):
    """Returns v, rotated by q."""
    return product(product(q, (0, *v)), (q[0], -q[1], -q[2], -q[3]))[1:]


imus = [store.deserialize_cdr(bytes(sample.payload), "sensor_msgs/msg/Imu") for sample in samples]
orientations = {stamp_ns(imu.header): (imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z) for imu in imus}
tf, mag = None, None
if transforms:
    tfs, tf = decoded(transforms, "tf")
    tf["frames"] = sorted({(t.header.frame_id, t.child_frame_id) for message in tfs for t in message.transforms})
    tf["translations"] = sorted({(t.transform.translation.x, t.transform.translation.y, t.transform.translation.z) for message in tfs for t in message.transforms})
    tf["unequal"] = sum(
        len(message.transforms) != 1 or orientations.get(stamp_ns(t.header)) != (t.transform.rotation.w, t.transform.rotation.x, t.transform.rotation.y, t.transform.rotation.z)
        for message in tfs for t in message.transforms
    )
if fields:
    mags, mag = decoded(fields, "mag")
    # The field has the same direction in east-north-up for every orientation.
    in_earth = []
    for message in mags:
        nearest = min(orientations, key=lambda t: abs(t - stamp_ns(message.header)))
        m = message.magnetic_field
        if abs(nearest - stamp_ns(message.header)) < 6e6:
            in_earth.append(turned(orientations[nearest], (m.x, m.y, m.z)))
    mean = [sum(column) / len(in_earth) for column in zip(*in_earth)]
    mag["compared"], mag["mean_t"] = len(in_earth), mean
    mag["spread_t"] = max(abs(a - b) for field in in_earth for a, b in zip(field, mean))
    mag["frames"] = sorted({message.header.frame_id for message in mags})
    mag["covariance_is_unknown"] = all(not any(message.magnetic_field_covariance) for message in mags)
arrays, found = decoded(diagnostics, "diagnostics")
found["statuses"] = [
    {"level": status.level, "name": status.name, "message": status.message, "hardware_id": status.hardware_id, "values": {v.key: v.value for v in status.values}}
    for status in arrays[-1].status
]
imu_gids = sorted({number[3] for number in numbers})

print(json.dumps({
    "tf": tf, "mag": mag, "diagnostics": found, "different_publishers": len({*imu_gids, *found["gids"], *(tf["gids"] if tf else []), *(mag["gids"] if mag else [])}),
    "hash": store.hash_rihs01("sensor_msgs/msg/Imu"), "key": str(samples[0].key_expr), "tokens": tokens, "complete": bool(complete),
    "max_difference": max_difference, "fastest_rad_s": fastest, "rate_error_rad_s": rate_error,
    "force_m_s2": sum(forces) / len(forces), "covariances": bool(all(covariances)),
    "numbers_follow": all(b[0] == a[0] + 1 for a, b in zip(numbers, numbers[1:])), "publisher": [numbers[0][2], len({n[3] for n in numbers}), numbers[0][4]],
    "late_s": max(n[1] - s for n, s in zip(numbers, stamps)) / 1e9, "early_s": min(n[1] - s for n, s in zip(numbers, stamps)) / 1e9,
    "step_ms": (stamps[-1] - stamps[0]) / (len(stamps) - 1) / 1e6,
}), flush=True)
# Exits directly, because Zenoh's threads delay a normal exit of the interpreter.
os._exit(0)
