"""A ground station of pymavlink: what it hears, one JSON object a line.

`PORT COUNT`: until it has heard so many attitudes of each kind and a heartbeat between them.
"""

import json
import sys

from pymavlink import mavutil

port, count = sys.argv[1], int(sys.argv[2])
link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="common")
print("ready", flush=True)
missing = {"HEARTBEAT": 1, "ATTITUDE": count, "ATTITUDE_QUATERNION": count}
while any(left > 0 for left in missing.values()):
    message = link.recv_match(blocking=True, timeout=30)
    assert message is not None, f"nothing came for 30 s; missing {missing}"
    kind = message.get_type()
    if kind in missing:
        missing[kind] -= 1
        said = message.to_dict() | {"system": message.get_srcSystem(), "component": message.get_srcComponent(), "sequence": message.get_seq()}
        print(json.dumps(said), flush=True)
