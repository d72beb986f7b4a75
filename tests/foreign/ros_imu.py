"""A node of ROS 2 as rmw_zenoh makes one, with its router, that publishes an IMU: `PORT`. It says `ready`, sends from the first line of standard input
to the second, then says in one line of JSON how many messages it sent, and which signs of life it saw.

The body leans to its right side by 20° and turns by 10 °/s about the vertical; 200 Hz, and a field with every fourth. Every tenth Imu is
damaged and every fiftieth says that it has no rate: those are not counted.
"""

import json
import math
import os
import sys
import threading
import time

import numpy
import zenoh
from rosbags.typesys import Stores, get_typestore

GRAVITY = 9.80665
store = get_typestore(Stores.ROS2_JAZZY)
types = store.types
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
tokens = []
seen = session.liveliness().declare_subscriber("@ros2_lv/7/**", lambda it: tokens.append((str(it.kind).split(".")[-1], str(it.key_expr))))


def publisher(topic, name):
    key = f"7/{topic}/sensor_msgs::msg::dds_::{name}_/{store.hash_rihs01(f'sensor_msgs/msg/{name}')}"
    return session.declare_publisher(key)


def vector(x, y, z):
    return types["geometry_msgs/msg/Vector3"](x, y, z)


imus, fields = publisher("vehicle/imu", "Imu"), publisher("vehicle/mag", "MagneticField")
print("ready", flush=True)
sys.stdin.readline()
ends = threading.Event()
threading.Thread(target=lambda: (sys.stdin.readline(), ends.set()), daemon=True).start()
lean, rate = math.radians(20), math.radians(10)
none, absent = numpy.zeros(9), numpy.array([-1.0] + [0.0] * 8)
sent = {"imus": 0, "fields": 0}
began, n = time.time_ns(), 0
while not ends.is_set():
    stamp_ns = began + n * 5_000_000
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp, "body")
    is_damaged, has_none = n % 10 == 9, n % 50 == 25
    # Forward, left, up: leaning to the right, the left side is up.
    up = (0.0, math.sin(lean), math.cos(lean))
    imu = types["sensor_msgs/msg/Imu"](
        header, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), absent, vector(*(rate * part for part in up)),
        absent if has_none else none, vector(*(GRAVITY * part for part in up)), none,
    )
    if n % 4 == 0:
        angle = rate * n / 200
        earth = (20e-6 * math.cos(angle), -20e-6 * math.sin(angle), -40e-6)
        field = (earth[0], math.cos(lean) * earth[1] + math.sin(lean) * earth[2], -math.sin(lean) * earth[1] + math.cos(lean) * earth[2])
        fields.put(bytes(store.serialize_cdr(types["sensor_msgs/msg/MagneticField"](header, vector(*field), none), "sensor_msgs/msg/MagneticField")))
        sent["fields"] += 1
    data = bytes(store.serialize_cdr(imu, "sensor_msgs/msg/Imu"))
    imus.put(data[: 40 + n % 200] if is_damaged else data)
    sent["imus"] += not is_damaged and not has_none
    n += 1
    time.sleep(max(0.0, (began + n * 5_000_000 - time.time_ns()) / 1e9))
print(json.dumps(sent | {"messages": n, "tokens": tokens}), flush=True)
sys.stdin.readline()
# Zenoh's threads would hold up an interpreter that ends.
os._exit(0)
