"""Simulates an IMU on a serial port: `python3 examples/serial_imu.py imu MOTION`.

The port is a pseudo-terminal, and `imu` becomes a symbolic link to it. MOTION is the movement of the unit: `rest`, `sides` (each
side up in turn), `turns` (about all axes) and `poses` (the vehicle level, then nose down) are repeated endlessly, `drive` ends
after 60 s. The motion starts when the port is first opened.

The unit prints lines of `t,gx,gy,gz,ax,ay,az,mx,my,mz` at 100 Hz: s, °/s, g, µT, in the unit's axes. It has sensor errors (biases,
scale errors, hard iron, noise) and is mounted in the vehicle rotated by 90° and tilted by 3°. `--truth FILE` writes the vehicle's
attitude as `t_s,qw,qx,qy,qz`, body (right, forward, up) to east, north, up. `--speed 5` runs five times as fast as real time.
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


def rotate(q, vector):
    return product(product(q, (0.0, *vector)), inverse(q))[1:]


def rotation(vector_rad):
    """Returns the quaternion of a rotation vector."""
    angle = math.sqrt(sum(part * part for part in vector_rad))
    fraction = math.sin(angle / 2) / angle if angle > 0 else 0.5
    return (math.cos(angle / 2), *(part * fraction for part in vector_rad))


def rotation_vector(q):
    """Returns the rotation vector of a quaternion, at most half a revolution."""
    sine = math.sqrt(sum(part * part for part in q[1:]))
    angle = 2 * math.atan2(math.copysign(sine, q[0]), abs(q[0]))
    return [part * angle / sine if sine > 0 else 0.0 for part in q[1:]]


def from_degrees(x, y, z):
    return rotation([math.radians(part) for part in (x, y, z)])


# Rotation from the unit's axes to the vehicle's.
MOUNTING = product(from_degrees(0, 3, 0), from_degrees(0, 0, 90))
LEVEL = (1.0, 0.0, 0.0, 0.0)
SIDES = [from_degrees(*angles) for angles in [(0, 0, 0), (90, 0, 0), (180, 0, 0), (-90, 0, 0), (0, 90, 0), (0, -90, 0)]]


def hold_poses(poses, hold_s, move_s):
    """Yields the poses in an endless loop, with the shortest rotation between them."""
    previous = poses[0]
    while True:
        for pose in poses:
            movement = rotation_vector(product(inverse(previous), pose))
            steps = round(move_s / STEP_S) if any(abs(part) > 1e-9 for part in movement) else 0
            for step in range(steps):
                fraction = (1 - math.cos(math.pi * (step + 1) / steps)) / 2
                yield product(previous, rotation([part * fraction for part in movement]))
            for _ in range(round(hold_s / STEP_S)):
                yield pose
            previous = pose


def swing(rate_deg_s, seconds=math.inf):
    """Yields attitudes with oscillating rates, after two seconds of rest."""
    attitude, t_s = LEVEL, 0.0
    while t_s < seconds:
        t_s += STEP_S
        x, y, z = rate_deg_s if t_s > 2 else (0, 0, 0)
        rates = x * math.sin(1.3 * t_s), y * math.sin(0.9 * t_s + 1), z * math.cos(0.31 * t_s)
        attitude = product(attitude, rotation([math.radians(rate) * STEP_S for rate in rates]))
        yield attitude


MOTIONS = {
    "rest": lambda: hold_poses([LEVEL], 1, 0),
    "sides": lambda: hold_poses([product(side, inverse(MOUNTING)) for side in SIDES], 3, 1.5),
    "turns": lambda: swing((150, 120, 60)),
    "poses": lambda: hold_poses([LEVEL, from_degrees(-45, 0, 0)], 4, 2),
    "drive": lambda: swing((20, 30, 40), 60),
}


def unit_output(previous, after, rng):
    """Returns the unit's measurements for a step between two attitudes of the vehicle."""
    previous, after = product(previous, MOUNTING), product(after, MOUNTING)
    noisy = lambda value, sd: value + rng.gauss(0, sd)
    rate = [part / STEP_S for part in rotation_vector(product(inverse(previous), after))]
    rate = [noisy(part + bias, GYRO_NOISE_RAD_S) for part, bias in zip(rate, GYRO_BIAS_RAD_S)]
    force = rotate(inverse(after), (0.0, 0.0, GRAVITY_M_S2))
    force = [noisy(part / scale + bias, ACCEL_NOISE_M_S2) for part, scale, bias in zip(force, ACCEL_SCALE, ACCEL_BIAS_M_S2)]
    field = rotate(inverse(after), FIELD_UT)
    field = [noisy(part + iron, FIELD_NOISE_UT) for part, iron in zip(field, HARD_IRON_UT)]
    return [*(math.degrees(part) for part in rate), *(part / GRAVITY_M_S2 for part in force), *field]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("link")
    parser.add_argument("motion", choices=MOTIONS)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--truth")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    master, terminal = os.openpty()
    tty.setraw(terminal)
    if os.path.islink(options.link):
        os.unlink(options.link)
    os.symlink(os.ttyname(terminal), options.link)
    # This process closes the terminal itself, so that POLLHUP is set until a reader opens the port.
    os.close(terminal)
    poller = select.poll()
    poller.register(master, select.POLLOUT)
    truth = open(options.truth, "w") if options.truth else None
    if truth:
        print("t_s,qw,qx,qy,qz", file=truth)
    rng = random.Random(options.motion)
    previous = None
    try:
        # The motion starts when a reader opens the port.
        while any(event & select.POLLHUP for _, event in poller.poll(1000)):
            time.sleep(0.01)
        # All runs use the same clock, so the unit's time continues after a restart.
        start = time.monotonic()
        for n, attitude in enumerate(MOTIONS[options.motion]()):
            t_s = round(start * options.speed, 2) + n * STEP_S
            numbers = ",".join(f"{number:.6f}" for number in unit_output(previous or attitude, attitude, rng))
            previous = attitude
            if any(event & select.POLLOUT and not event & select.POLLHUP for _, event in poller.poll(1000)):
                os.write(master, f"{t_s:.2f},{numbers}\n".encode())
            if truth:
                print(f"{t_s:.2f}", *(f"{part:.9f}" for part in attitude), sep=",", file=truth)
            due = start + (n + 1) * STEP_S / options.speed
            time.sleep(max(0.0, due - time.monotonic()))
    except KeyboardInterrupt:
        pass
    finally:
        os.unlink(options.link)
        if truth:
            truth.close()


main()
