"""A sensor of your own on the bus of a running system, whose launch file says `[ingest] source = "bus"`: `pip install iceoryx2==0.10.0`, then
`PYTHONPATH=crates/sdk/python python3 examples/sensor.py NAME`."""

import sys
import time

from plumbline.sensor import FeedError, Sensor

sensor = Sensor(sys.argv[1] if len(sys.argv) > 1 else "plumbline")
while True:
    # In place of these: what the device says, rad/s and m/s², in its own axes, and when it measured.
    rate_rad_s, force_m_s2 = (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)
    try:
        sensor.send(time.monotonic_ns(), rate_rad_s, force_m_s2)
    except FeedError as error:
        print(error, file=sys.stderr)
        time.sleep(1)
    time.sleep(0.001)
