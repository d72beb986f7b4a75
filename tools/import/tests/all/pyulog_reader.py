"""Prints the samples that pyulog reads from a log, one per line, numbers with all digits."""

import sys

from pyulog import ULog

FIELDS = {
    "sensor_combined": ["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]", "accelerometer_m_s2[0]", "accelerometer_m_s2[1]",
                        "accelerometer_m_s2[2]", "accelerometer_timestamp_relative"],
    "own_field": ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]", "magnetometer_timestamp_relative"],
    "vehicle_magnetometer": ["magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"],
    "vehicle_attitude": ["q[0]", "q[1]", "q[2]", "q[3]"],
    "vehicle_gps_position": ["vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "lat", "lon", "alt"],
}

for data in ULog(sys.argv[1]).data_list:
    names = [data.name] + (["own_field"] if data.name == "sensor_combined" else [])
    for name in names:
        fields = FIELDS.get(name, ["?"])
        if data.multi_id != 0 or any(field not in data.data for field in fields):
            continue
        columns = [data.data["timestamp"]] + [data.data[field] for field in fields]
        for values in zip(*columns):
            print(name, *(repr(value.item()) for value in values))
