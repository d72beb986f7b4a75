"""Publishes readings to a system until standard input ends: SYSTEM.

Each reading is printed as one line of JSON. Floating-point numbers are printed as their bits.
"""

import json
import math
import struct
import sys
import threading
import time

from plumbline.sensor import FeedError, Receiver, Sensor


def bits(numbers):
    return [struct.unpack("=Q", struct.pack("=d", number))[0] for number in numbers]


name = sys.argv[1]
try:
    sensor, receiver = Sensor(name), Receiver(name)
except FeedError as error:
    print(error)
    sys.exit(1)
print(json.dumps({"capacity": sensor.capacity, "layouts": [Sensor.LAYOUT, Receiver.LAYOUT], "topic_indices": [Sensor.TOPIC_INDEX, Receiver.TOPIC_INDEX]}), flush=True)
ended = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
count, failed = 0, 0
while not ended.is_set():
    count += 1
    t_ns = count * 5_000_000 + 7
    rate_rad_s = (0.1 / 3 + count * 1e-7, -0.0, 0.1)
    force_m_s2 = (math.sin(count), -math.pi / 1000, 9.8)
    field_ut = (20.0 + count / 3, -1.5, -44.1) if count % 3 == 0 else None
    velocity_m_s = (count / 7, 2.5, -0.1) if count % 40 == 0 else None
    try:
        if velocity_m_s:
            receiver.send(velocity_m_s, sd_m_s=0.3, latitude_rad=0.9)
        sensor.send(t_ns, rate_rad_s, force_m_s2, field_ut)
        field = None if field_ut is None else bits(field_ut)
        velocity = None if velocity_m_s is None else bits(velocity_m_s)
        print(json.dumps({"t": t_ns, "rate": bits(rate_rad_s), "force": bits(force_m_s2), "field": field, "velocity": velocity}), flush=True)
    except FeedError as error:
        failed += 1
        # Both publishers are closed, because both have joined the run of the system that has ended.
        sensor.close()
        receiver.close()
        print(json.dumps({"gone": str(error)}), flush=True)
    time.sleep(0.005)
sensor.close()
receiver.close()
print(json.dumps({"failed": failed}), flush=True)
