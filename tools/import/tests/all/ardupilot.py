"""Prints the messages that pymavlink reads from a DataFlash log, one per line, numbers with all digits."""

import sys

from pymavlink.DFReader import DFReader_binary

FIELDS = {
    "IMU": ["I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"],
    "MAG": ["I", "MagX", "MagY", "MagZ"],
    "GPS": ["I", "Status", "Spd", "GCrs", "VZ", "Lat", "Lng", "Alt"],
    "XKQ": ["C", "Q1", "Q2", "Q3", "Q4"],
    "ATT": ["Roll", "Pitch", "Yaw"],
}

log = DFReader_binary(sys.argv[1])
while (message := log.recv_msg()) is not None:
    name = message.get_type()
    if name in FIELDS:
        fields = message.to_dict()
        # Old logs have times in ms, and messages without the number of the sensor.
        t_us = fields["TimeUS"] if "TimeUS" in fields else 1000 * fields["TimeMS"]
        print(name, t_us, *(repr(float(fields.get(field, 0))) for field in FIELDS[name]))
