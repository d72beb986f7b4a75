"""Publishes readings of a user-defined sensor to a running system whose launch file sets `[ingest] source = "bus"`.

Install iceoryx2 with `pip install iceoryx2==0.10.0`, then run `PYTHONPATH=crates/sdk/python python3 examples/sensor.py NAME`.
"""

import sys
import time

from plumbline.sensor import FeedError, Sensor

sensor = Sensor(sys.argv[1] if len(sys.argv) > 1 else "plumbline")
while True:
    # Replace these with the device's measurements, in rad/s and m/s² in its own axes, and the timestamp with the time of the measurement.
    rate_rad_s, force_m_s2 = (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)
    try:
        sensor.send(time.monotonic_ns(), rate_rad_s, force_m_s2)
    except FeedError as error:
        print(error, file=sys.stderr)
        time.sleep(1)
    time.sleep(0.001)
