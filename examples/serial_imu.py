"""A bare IMU on a serial line, for whoever has none at hand: `python3 examples/serial_imu.py imu MOTION`.

The line is a pseudo-terminal, to which `imu` is made a symbolic link. MOTION is what a hand does with the unit: `rest`, `sides`
(each side up in turn), `turns` (about all axes), `poses` (the vehicle level, then nose down), each for ever, or `drive`, which ends after 60 s.
It begins when the line is first opened.

Lines are `t,gx,gy,gz,ax,ay,az,mx,my,mz` at 100 Hz: s, °/s, g, µT, in the unit's axes. The unit has errors: biases, scales, iron beside the
magnetometer, noise; and it sits in the vehicle turned by 90° and tilted by 3°. `--truth FILE` writes the vehicle's attitude as
`t_s,qw,qx,qy,qz`, body (right, forward, up) to east, north, up. `--speed 5` makes five seconds of one.
"""

import argparse
import math
import os
import random
import select
import signal
import sys
import time
import tty

STEP_S = 0.01
GRAVITY_M_S2 = 9.80665
FIELD_UT = (0.0, 18.0, -45.0)
GYRO_BIAS_RAD_S, GYRO_NOISE_RAD_S = (0.02, -0.03, 0.01), 0.002
ACCEL_BIAS_M_S2, ACCEL_SCALE, ACCEL_NOISE_M_S2 = (0.3, -0.2, 0.25), (1.02, 0.985, 1.01), 0.02
HARD_IRON_UT, FIELD_NOISE_UT = (25.0, -14.0, 9.0), 0.2


def product(p, q):
    (a, b, c, d), (w, x, y, z) = p, q
    return (a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w)


def inverse(q):
    return (q[0], -q[1], -q[2], -q[3])


def turned(q, vector):
    return product(product(q, (0.0, *vector)), inverse(q))[1:]


def turn(vector_rad):
    """The rotation by a vector."""
    angle = math.sqrt(sum(part * part for part in vector_rad))
    share = math.sin(angle / 2) / angle if angle > 0 else 0.5
    return (math.cos(angle / 2), *(part * share for part in vector_rad))


def turn_vector(q):
    """The vector of a rotation, by the shorter way."""
    sine = math.sqrt(sum(part * part for part in q[1:]))
    angle = 2 * math.atan2(math.copysign(sine, q[0]), abs(q[0]))
    return [part * angle / sine if sine > 0 else 0.0 for part in q[1:]]


def degrees(x, y, z):
    return turn([math.radians(part) for part in (x, y, z)])


# From the unit's axes to the vehicle's.
MOUNTING = product(degrees(0, 3, 0), degrees(0, 0, 90))
LEVEL = (1.0, 0.0, 0.0, 0.0)
SIDES = [degrees(*angles) for angles in [(0, 0, 0), (90, 0, 0), (180, 0, 0), (-90, 0, 0), (0, 90, 0), (0, -90, 0)]]


def held(poses, hold_s, move_s):
    """Pose after pose, for ever, from each to the next by the shortest turn."""
    before = poses[0]
    while True:
        for pose in poses:
            way = turn_vector(product(inverse(before), pose))
            steps = round(move_s / STEP_S) if any(abs(part) > 1e-9 for part in way) else 0
            for step in range(steps):
                share = (1 - math.cos(math.pi * (step + 1) / steps)) / 2
                yield product(before, turn([part * share for part in way]))
            for _ in range(round(hold_s / STEP_S)):
                yield pose
            before = pose


def swung(rate_deg_s, seconds=math.inf):
    """Rates that come and go, after two seconds of rest."""
    attitude, t_s = LEVEL, 0.0
    while t_s < seconds:
        t_s += STEP_S
        x, y, z = rate_deg_s if t_s > 2 else (0, 0, 0)
        rates = x * math.sin(1.3 * t_s), y * math.sin(0.9 * t_s + 1), z * math.cos(0.31 * t_s)
        attitude = product(attitude, turn([math.radians(rate) * STEP_S for rate in rates]))
        yield attitude


MOTIONS = {
    "rest": lambda: held([LEVEL], 1, 0),
    "sides": lambda: held([product(side, inverse(MOUNTING)) for side in SIDES], 3, 1.5),
    "turns": lambda: swung((150, 120, 60)),
    "poses": lambda: held([LEVEL, degrees(-45, 0, 0)], 4, 2),
    "drive": lambda: swung((20, 30, 40), 60),
}


def said(before, after, dice):
    """What the unit says of a step between two attitudes of the vehicle."""
    before, after = product(before, MOUNTING), product(after, MOUNTING)
    noisy = lambda value, sd: value + dice.gauss(0, sd)
    rate = [part / STEP_S for part in turn_vector(product(inverse(before), after))]
    rate = [noisy(part + bias, GYRO_NOISE_RAD_S) for part, bias in zip(rate, GYRO_BIAS_RAD_S)]
    force = turned(inverse(after), (0.0, 0.0, GRAVITY_M_S2))
    force = [noisy(part / scale + bias, ACCEL_NOISE_M_S2) for part, scale, bias in zip(force, ACCEL_SCALE, ACCEL_BIAS_M_S2)]
    field = turned(inverse(after), FIELD_UT)
    field = [noisy(part + iron, FIELD_NOISE_UT) for part, iron in zip(field, HARD_IRON_UT)]
    return [*(math.degrees(part) for part in rate), *(part / GRAVITY_M_S2 for part in force), *field]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("line")
    parser.add_argument("motion", choices=MOTIONS)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--truth")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    device, other = os.openpty()
    tty.setraw(other)
    if os.path.islink(options.line):
        os.unlink(options.line)
    os.symlink(os.ttyname(other), options.line)
    # From here on it is seen whether somebody else has the line open.
    os.close(other)
    line = select.poll()
    line.register(device, select.POLLOUT)
    truth = open(options.truth, "w") if options.truth else None
    if truth:
        print("t_s,qw,qx,qy,qz", file=truth)
    dice = random.Random(options.motion)
    before = None
    try:
        # The hand begins when somebody hears the unit.
        while any(what & select.POLLHUP for _, what in line.poll(1000)):
            time.sleep(0.01)
        # One clock for all starts, so that the unit's time goes on.
        began = time.monotonic()
        for n, attitude in enumerate(MOTIONS[options.motion]()):
            t_s = round(began * options.speed, 2) + n * STEP_S
            numbers = ",".join(f"{number:.6f}" for number in said(before or attitude, attitude, dice))
            before = attitude
            if any(what & select.POLLOUT and not what & select.POLLHUP for _, what in line.poll(1000)):
                os.write(device, f"{t_s:.2f},{numbers}\n".encode())
            if truth:
                print(f"{t_s:.2f}", *(f"{part:.9f}" for part in attitude), sep=",", file=truth)
            due = began + (n + 1) * STEP_S / options.speed
            time.sleep(max(0.0, due - time.monotonic()))
    except KeyboardInterrupt:
        pass
    finally:
        os.unlink(options.line)
        if truth:
            truth.close()


main()
