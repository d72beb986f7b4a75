"""Ground station based on pymavlink: PORT COUNT [POSITIONS].

Prints `ready`, receives COUNT attitudes and prints `received`. With a third argument, it also waits
for that number of positions. Then it reads the path of an
attitude file (written by `plumb up --out`: east-north-up, right-forward-up) from standard input and
prints the differences as one line of JSON.
"""

import json
import math
import statistics
import sys

from pymavlink import mavutil
from pymavlink.rotmat import Matrix3, Vector3

port, count = int(sys.argv[1]), int(sys.argv[2])
wanted_positions = int(sys.argv[3]) if len(sys.argv) > 3 else 0
link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="common")
print("ready", flush=True)

heartbeats, quaternions, angles, odometry, positions, numbers = [], {}, {}, {}, [], []
while min(len(quaternions), len(angles), len(odometry)) < count or len(heartbeats) < 3 or len(positions) < wanted_positions:
    message = link.recv_match(blocking=True, timeout=60)
    if message is None:
        break
    kind = message.get_type()
    numbers.append(message.get_seq())
    if kind == "HEARTBEAT":
        heartbeats.append((message.get_srcSystem(), message.get_srcComponent(), message.type, message.autopilot, message.system_status))
    elif kind == "ATTITUDE_QUATERNION":
        quaternions[message.time_boot_ms] = message
    elif kind == "ATTITUDE":
        angles[message.time_boot_ms] = message
    elif kind == "ODOMETRY":
        odometry[message.time_usec // 1000] = message
    elif kind == "GLOBAL_POSITION_INT":
        positions.append(message.to_dict())
print("received", flush=True)


def rotation(w, x, y, z):
    """Returns the rotation matrix from body to reference axes."""
    return Matrix3(
        Vector3(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        Vector3(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        Vector3(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


# Converts between east-north-up and north-east-down, and between right-forward-up and
# forward-right-down.
SWAP = Matrix3(Vector3(0, 1, 0), Vector3(1, 0, 0), Vector3(0, 0, -1))


def rotation_vector(a, b):
    """Returns the rotation vector from a to b, rad, in the axes of a, for small rotations."""
    d = a.transposed() * b
    return Vector3(d.c.y - d.b.z, d.a.z - d.c.x, d.b.x - d.a.y) * 0.5


expected = {}
with open(sys.stdin.readline().strip()) as lines:
    next(lines)
    for line in lines:
        t_s, *q = map(float, line.split(","))
        expected[math.floor(t_s * 1000 + 1e-6)] = SWAP * rotation(*q) * SWAP.transposed()

differences = {"quaternion_rad": 0, "angles_rad": 0}
times = sorted(quaternions.keys() & angles.keys() & expected.keys())
fastest, rate_errors = 0, []
for t in times:
    q, a = quaternions[t], angles[t]
    euler = Matrix3()
    euler.from_euler(a.roll, a.pitch, a.yaw)
    found = {
        "quaternion_rad": rotation_vector(expected[t], rotation(q.q1, q.q2, q.q3, q.q4)).length(),
        "angles_rad": rotation_vector(expected[t], euler).length(),
    }
    if t - 1 in expected:
        rate = rotation_vector(expected[t - 1], expected[t]) * 1000
        fastest = max(fastest, rate.length())
        rate_errors.append(max((rate - Vector3(m.rollspeed, m.pitchspeed, m.yawspeed)).length() for m in (q, a)))
    differences = {name: max(differences[name], found[name]) for name in differences}

# The messages for one attitude must have equal values in the fields that they share.
ROTATION_VARIANCES = (15, 18, 20)
unequal = [
    t for t, o in odometry.items()
    if (q := quaternions.get(t)) and (tuple(o.q), o.rollspeed, o.pitchspeed, o.yawspeed) != ((q.q1, q.q2, q.q3, q.q4), q.rollspeed, q.pitchspeed, q.yawspeed)
]
unknown = all(
    math.isnan(number)
    for o in odometry.values()
    for number in (o.x, o.y, o.z, o.vx, o.vy, o.vz, *o.velocity_covariance, *(c for i, c in enumerate(o.pose_covariance) if i not in ROTATION_VARIANCES))
)
variances = all(o.pose_covariance[i] > 0 for o in odometry.values() for i in ROTATION_VARIANCES)

lost = sum((b - a - 1) % 256 for a, b in zip(numbers, numbers[1:]))
steps = sorted({b - a for a, b in zip(times, times[1:])})
print(json.dumps({
    "compared": len(times), "unmatched": len(quaternions) - len(times), "lost": lost, "steps_ms": steps,
    "odometry": len(odometry), "unequal_odometry": len(unequal), "unknown_is_nan": unknown, "variances": variances,
    "frames": sorted({(o.frame_id, o.child_frame_id, o.estimator_type, o.quality) for o in odometry.values()}), "positions": positions,
    "heartbeats": heartbeats, "fastest_rad_s": fastest, **differences,
    "rate_rad_s": max(rate_errors, default=None), "usual_rate_rad_s": statistics.median(rate_errors) if rate_errors else None,
}))
