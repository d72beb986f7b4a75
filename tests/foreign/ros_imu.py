"""ROS 2 node that publishes IMU readings, with its own rmw_zenoh router: PORT.

Prints `ready`. Publishes from the first line on standard input until the second. Then it prints the
number of published messages and the received liveliness tokens as one line of JSON.

The body leans to the right by 20° and rotates at 10 °/s about the vertical. Readings are published
at 200 Hz, every fourth one with a magnetic field. Every tenth Imu message is damaged, and every
fiftieth is marked as having no rate; these are not counted as sent.
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
subscription = session.liveliness().declare_subscriber("@ros2_lv/7/**", lambda it: tokens.append((str(it.kind).split(".")[-1], str(it.key_expr))))


def publisher(topic, name):
    key = f"7/{topic}/sensor_msgs::msg::dds_::{name}_/{store.hash_rihs01(f'sensor_msgs/msg/{name}')}"
    return session.declare_publisher(key)


def vector(x, y, z):
    return types["geometry_msgs/msg/Vector3"](x, y, z)


imus, fields = publisher("vehicle/imu", "Imu"), publisher("vehicle/mag", "MagneticField")
print("ready", flush=True)
sys.stdin.readline()
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
lean, rate = math.radians(20), math.radians(10)
zero, unavailable = numpy.zeros(9), numpy.array([-1.0] + [0.0] * 8)
sent = {"imus": 0, "fields": 0}
start_ns, n = time.time_ns(), 0
while not stop.is_set():
    stamp_ns = start_ns + n * 5_000_000
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp, "body")
    is_damaged, lacks_rate = n % 10 == 9, n % 50 == 25
    # The body axes are forward, left, up. If the body leans to the right, its left side points up.
    up = (0.0, math.sin(lean), math.cos(lean))
    imu = types["sensor_msgs/msg/Imu"](
        header, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), unavailable, vector(*(rate * part for part in up)),
        unavailable if lacks_rate else zero, vector(*(GRAVITY * part for part in up)), zero,
    )
    if n % 4 == 0:
        angle = rate * n / 200
        earth = (20e-6 * math.cos(angle), -20e-6 * math.sin(angle), -40e-6)
        field = (earth[0], math.cos(lean) * earth[1] + math.sin(lean) * earth[2], -math.sin(lean) * earth[1] + math.cos(lean) * earth[2])
        fields.put(bytes(store.serialize_cdr(types["sensor_msgs/msg/MagneticField"](header, vector(*field), zero), "sensor_msgs/msg/MagneticField")))
        sent["fields"] += 1
    data = bytes(store.serialize_cdr(imu, "sensor_msgs/msg/Imu"))
    imus.put(data[: 40 + n % 200] if is_damaged else data)
    sent["imus"] += not is_damaged and not lacks_rate
    n += 1
    time.sleep(max(0.0, (start_ns + n * 5_000_000 - time.time_ns()) / 1e9))
print(json.dumps(sent | {"messages": n, "tokens": tokens}), flush=True)
sys.stdin.readline()
# Exits directly, because Zenoh's threads delay a normal exit of the interpreter.
os._exit(0)
