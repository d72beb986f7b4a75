"""Writes messages of third-party encoders to a file and prints the expected measurements, one per line.

A line is `imu`, `field`, `fix`, or `skip` for a measurement that is not compared; then the clock (`boot`, `unix`, `counter` or
`none`), the time in ns, and numbers in SI units, µT, east-north-up. Unknown numbers are `nan`.
"""

import calendar
import math
import random
import sys

NAN = math.nan
GRAVITY = 9.80665


def expect(kind, clock, ns, *numbers):
    print(kind, clock, ns, *(repr(float(number)) for number in numbers))


def frd_to_rfu(frd):
    forward, right, down = frd
    return [right, forward, -down]


def mavlink(file, version):
    from pymavlink.dialects.v10 import ardupilotmega as one
    from pymavlink.dialects.v20 import ardupilotmega as two

    dialect = {"1": one, "2": two, "signed": two}[version]
    link = dialect.MAVLink(file, srcSystem=7, srcComponent=1)
    if version == "signed":
        link.signing.secret_key = bytes(range(32))
        link.signing.link_id = 3
        link.signing.timestamp = 1
        link.signing.sign_outgoing = True
    other_system = dialect.MAVLink(file, srcSystem=9, srcComponent=1)
    rng = random.Random(5)
    vector = lambda size: [round(rng.uniform(-size, size), 3) for _ in range(3)]
    to_f32 = lambda numbers: [__import__("struct").unpack("f", __import__("struct").pack("f", n))[0] for n in numbers]
    for n in range(300):
        us = 5_000_000 + n * 4000 + (1_700_000_000_000_000 if n >= 150 else 0)
        clock = "unix" if n >= 150 else "boot"
        force, rate, field = to_f32(vector(30)), to_f32(vector(5)), to_f32(vector(0.6))
        updated = [0x1FF, 0x03F, 0x1C0, 0x007, 0xFFFF][n % 5]
        link.heartbeat_send(2, 3, 0, 0, 4)
        link.highres_imu_send(us, *force, *rate, *field, 1013.25, 0.0, 100.0, 20.0, updated)
        rate, force, microtesla = frd_to_rfu(rate), frd_to_rfu(force), frd_to_rfu([100 * part for part in field])
        if updated & 0x3F == 0x3F:
            expect("imu", clock, us * 1000, *rate, *force, *(microtesla if updated & 0x1C0 == 0x1C0 else [NAN] * 3))
        elif updated & 0x1C0 == 0x1C0:
            expect("field", clock, us * 1000, *microtesla)
        # Messages that must be ignored: of another kind or another system.
        link.scaled_imu2_send(n * 4, 1, 2, 3, 4, 5, 6, 7, 8, 9)
        link.raw_imu_send(us, 1, 2, 3, 4, 5, 6, 7, 8, 9)
        other_system.highres_imu_send(us, *force, *rate, *field, 0, 0, 0, 0, 0x1FF)
        link.attitude_send(n * 4, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
        if n % 10 == 0:
            speed, course, kind = rng.randrange(5000), rng.randrange(36000), n // 10 % 5
            if n % 50 == 20:
                course = 65535
            link.gps_raw_int_send(us, kind, -377750000, 1449600000, 30000, 100, 100, speed, course, 12)
            if kind >= 2 and course != 65535:
                angle = math.radians(course / 100)
                velocity = [speed / 100 * math.sin(angle), speed / 100 * math.cos(angle), 0.0]
                expect("fix", clock, us * 1000, *velocity, 1.0, math.radians(-37.775), math.radians(144.96), 30.0)


def scaled(file):
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    link = dialect.MAVLink(file, srcSystem=1, srcComponent=1)
    rng = random.Random(6)
    for n in range(200):
        force, rate, field = ([rng.randrange(-size, size) for _ in range(3)] for size in (16000, 30000, 600))
        if n % 3 == 0:
            field = [0, 0, 0]
        link.scaled_imu2_send(n * 20, *force, *rate, *field)
        microtesla = frd_to_rfu([part * 0.1 for part in field]) if any(field) else [NAN] * 3
        rate, force = frd_to_rfu([part / 1000 for part in rate]), frd_to_rfu([part / 1000 * GRAVITY for part in force])
        expect("imu", "boot", n * 20_000_000, *rate, *force, *microtesla)
        vx, vy, vz = (rng.randrange(-3000, 3000) for _ in range(3))
        link.global_position_int_send(n * 20, 481000000, 115000000, 500000, 0, vx, vy, vz, 0)
        expect("fix", "boot", n * 20_000_000, vy / 100, vx / 100, -vz / 100, NAN, math.radians(48.1), math.radians(11.5), 500.0)


def ubx(file):
    from pyubx2 import GET, UBXMessage

    rng = random.Random(7)
    for n in range(300):
        north, east, down = (rng.randrange(-40000, 40000) for _ in range(3))
        kind, is_good, is_valid, invalid_position = n % 6, n % 7 != 3, n % 11 != 5, n % 13 == 4
        accuracy, nano = rng.randrange(10, 3000), rng.randrange(-400_000_000, 400_000_000)
        date = (2026, 2 + n % 2, 27 + n % 2, n % 24, n % 60, rng.randrange(60))
        message = UBXMessage(
            "NAV", "NAV-PVT", GET, iTOW=n * 100, year=date[0], month=date[1], day=date[2], hour=date[3], min=date[4],
            second=date[5], validDate=is_valid, validTime=1, nano=nano, fixType=kind, gnssFixOk=is_good, lon=144.96,
            lat=-37.775, hMSL=30123, velN=north, velE=east, velD=down, sAcc=accuracy, invalidLlh=invalid_position,
        )
        file.write(message.serialize())
        file.write(UBXMessage("NAV", "NAV-POSLLH", GET, iTOW=n, lat=1.0, lon=2.0).serialize())
        if kind in (2, 3, 4) and is_good:
            ns = calendar.timegm(date) * 1_000_000_000 + nano
            sd = max(accuracy / 1000, 1.0 if kind == 2 else 0.0)
            position = [NAN] * 3 if invalid_position else [math.radians(-37.775), math.radians(144.96), 30.123]
            expect("fix", "unix" if is_valid else "none", ns if is_valid else 0, east / 1000, north / 1000, -down / 1000, sd, *position)


def nmea(file):
    import datetime

    from pynmeagps import GET, NMEAMessage

    rng = random.Random(8)
    # VTG is used until the first RMC.
    file.write(NMEAMessage("GN", "VTG", GET, cogt=90.0, sogn=10.0, posMode="A").serialize())
    expect("fix", "none", 0, 10 * 1852 / 3600, 0.0, 0.0, 1.0, NAN, NAN, NAN)
    for n in range(300):
        time = datetime.time(n % 24, n % 60, (7 * n) % 60, n % 100 * 10_000)
        date = datetime.date(2026, 1 + n % 12, 1 + n % 28)
        speed, course = round(rng.uniform(0, 40), 2), round(rng.uniform(0, 359), 2)
        south = n % 2 == 0
        status, mode = ("V", "N") if n % 9 == 4 else ("A", "ADRFEMS"[n % 7])
        file.write(NMEAMessage(
            "GN", "RMC", GET, time=time, date=date, status=status, lat=-37.775 if south else 48.1, NS="S" if south else "N",
            lon=144.96, EW="E", spd=speed, cog=course, posMode=mode, navStatus="V").serialize())
        file.write(NMEAMessage("GN", "VTG", GET, cogt=course, sogn=speed, sogk=speed * 1.852, posMode=mode).serialize())
        file.write(NMEAMessage("GN", "GGA", GET, time=time, lat=48.1, NS="N", lon=11.5, EW="E", quality=1, numSV=8).serialize())
        if status == "A" and mode in "ADRF":
            ns = calendar.timegm((date.year, date.month, date.day, time.hour, time.minute, time.second)) * 1_000_000_000
            speed_m_s, angle = speed * 1852 / 3600, math.radians(course)
            velocity = speed_m_s * math.sin(angle), speed_m_s * math.cos(angle), 0.0
            expect("fix", "unix", ns + time.microsecond * 1000, *velocity, 1.0, math.radians(-37.775 if south else 48.1), math.radians(144.96), NAN)


def witmotion(file):
    """Writes random frames. The readers of the package `witmotion` give the expected values."""
    from witmotion import protocol

    rng = random.Random(9)
    for n in range(300):
        bodies = {kind: bytes(rng.randrange(256) for _ in range(8)) for kind in (0x51, 0x52, 0x53, 0x54)}
        parsed = {}
        for kind, body in bodies.items():
            reader = protocol.receive_messages[kind]
            parsed[kind] = reader.parse(body)
            file.write(bytes([0x55, kind]) + body + bytes([reader.compute_checksum(body)]))
        rate = [math.radians(part) for part in parsed[0x52].w]
        force = [part / protocol.G * GRAVITY for part in parsed[0x51].a]
        expect("imu", "none", 0, *rate, *force, *[NAN] * 3)
        expect("field", "none", 0, *(part * 0.1 for part in parsed[0x54].mag))


def rvc(file):
    """Writes rotations by multiples of 0.01°, first about one axis, then about the next. The reader of
    the package `adafruit_bno08x_rvc` gives the expected values."""
    import struct
    import types

    # The package refers to a type that exists only on microcontrollers.
    sys.modules["busio"] = types.SimpleNamespace(UART=object)
    from adafruit_bno08x_rvc import BNO08x_RVC

    rng = random.Random(10)
    yaw, pitch, roll, before = 0, 0, 0, None
    for n in range(300):
        axis, step = n // 100, rng.randrange(-300, 301)
        yaw, pitch, roll = (0 if n % 100 == 0 else angle for angle in (yaw, pitch, roll))
        yaw, pitch, roll = yaw + step * (axis == 0), pitch + step * (axis == 1), roll + step * (axis == 2)
        pitch = max(-8900, min(8900, pitch))
        body = struct.pack("<B6hBBB", n % 256, yaw, pitch, roll, *(rng.randrange(-4000, 4000) for _ in range(3)), 0, 0, 0)
        frame = body + bytes([sum(body) & 0xFF])
        file.write(b"\xaa\xaa" + frame)
        *angles, x, y, z = BNO08x_RVC._parse_frame(frame)
        if n % 100 > 0:
            rates = [math.radians(now - then) / 0.01 for now, then in zip(angles, before)]
            axis_rate = rates[axis]
            rate = [axis_rate * (axis == 1), axis_rate * (axis == 2), axis_rate * (axis == 0)]
            expect("imu", "counter", n % 256 * 10_000_000, *rate, *(part / 0.0098067 / 1000 * GRAVITY for part in (x, y, z)), *[NAN] * 3)
        elif n > 0:
            expect("skip", "none", 0)
        before = angles


def mavlink_all(file):
    """Writes every message of the dialect `ardupilotmega`, with a payload of zeros. Only SCALED_IMU
    yields a measurement."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    link = dialect.MAVLink(file, srcSystem=1, srcComponent=1)
    for kind in dialect.mavlink_map.values():
        message = dialect.MAVLink_message(kind.id, kind.msgname)
        file.write(message._pack(link, kind.crc_extra, bytes(kind.unpacker.size)))
    expect("skip", "none", 0)


with open(sys.argv[2], "wb") as out:
    {"witmotion": lambda: witmotion(out), "rvc": lambda: rvc(out), "mavlink-1": lambda: mavlink(out, "1"), "mavlink-2": lambda: mavlink(out, "2"),
     "mavlink-signed": lambda: mavlink(out, "signed"), "mavlink-all": lambda: mavlink_all(out), "scaled": lambda: scaled(out), "ubx": lambda: ubx(out),
     "nmea": lambda: nmea(out)}[sys.argv[1]]()
