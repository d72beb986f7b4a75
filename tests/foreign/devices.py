"""Simulated devices with messages encoded by third-party packages.

`mavlink PORT`: an autopilot over UDP, level and moving north-east at 5 m/s.
`ubx PORT`, `nmea PORT`: a GNSS receiver with the same motion, as a TCP server. It ends when its
client disconnects.
"""

import math
import socket
import sys
import time

GRAVITY = 9.80665
LATITUDE, LONGITUDE = 48.1, 11.5


def mavlink(port):
    from pymavlink import mavutil
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", dialect="ardupilotmega", source_system=7).mav
    updated = dialect.HIGHRES_IMU_UPDATED_XACC | 0x3F
    for n in range(100_000):
        us = 5_000_000 + n * 5000
        try:
            if n % 200 == 0:
                link.heartbeat_send(2, 12, 0, 0, 4)
            link.highres_imu_send(us, 0, 0, -GRAVITY, 0, 0, 0.1, 0, 0, 0, 0, 0, 0, 0, updated)
            link.attitude_send(n * 5, 0, 0, 0, 0, 0, 0.1)
            if n % 40 == 0:
                link.gps_raw_int_send(us, 3, int(LATITUDE * 1e7), int(LONGITUDE * 1e7), 520_000, 100, 100, 500, 4500, 12)
        except ConnectionRefusedError:
            pass
        time.sleep(0.005)


def serve(port, message):
    with socket.create_server(("127.0.0.1", int(port))) as server:
        print("ready", flush=True)
        connection, _ = server.accept()
        for n in range(100_000):
            connection.sendall(message(n))
            time.sleep(0.1)


def ubx(n):
    from pyubx2 import GET, UBXMessage

    speed = int(5000 / math.sqrt(2))
    return UBXMessage(
        "NAV", "NAV-PVT", GET, iTOW=n * 100, year=2026, month=11, day=23, hour=12, min=n // 600 % 60, second=n // 10 % 60,
        validDate=1, validTime=1, fixType=3, gnssFixOk=1, lat=LATITUDE, lon=LONGITUDE, hMSL=520_000, velN=speed, velE=speed,
        velD=0, sAcc=200,
    ).serialize()


def nmea(n):
    import datetime

    from pynmeagps import GET, NMEAMessage

    time_of_day = datetime.time(12, n // 600 % 60, n // 10 % 60, n % 10 * 100_000)
    return NMEAMessage(
        "GN", "RMC", GET, time=time_of_day, date=datetime.date(2026, 11, 23), status="A", lat=LATITUDE, NS="N", lon=LONGITUDE,
        EW="E", spd=5 * 3600 / 1852, cog=45.0, posMode="A", navStatus="V",
    ).serialize()


kind, port = sys.argv[1:]
{"mavlink": mavlink, "ubx": lambda port: serve(port, ubx), "nmea": lambda port: serve(port, nmea)}[kind](port)
