"""Files of public programs: never a wrong number without a question, and the right one with the proposal.

The header of each is as its source shows it; the numbers are our own. All have the same true samples, with a noise of
its own on each axis, so that a swapped or repeated axis shows.
"""

# a header is one line, however long its program writes it
# ruff: noqa: E501

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imumon.model.errors import ImumonError
from imumon.model.samples import SampleBlock
from imumon.sources.files import ReadOptions, open_recording

RATE = 100.0
COUNT = 1200
DEG, G = np.pi / 180.0, 9.80665
GYRO_N = np.array([1.0e-4, 2.0e-4, 3.0e-4])
"""rad/s/sqrt(Hz), true angle random walk of x, y, z."""
ACCEL_N = np.array([1.0e-3, 1.5e-3, 2.0e-3])
"""m/s^2/sqrt(Hz), true velocity random walk of x, y, z."""
_rng = np.random.default_rng(50)
GYRO = np.array([0.004, -0.003, 0.002]) + GYRO_N * RATE**0.5 * _rng.normal(size=(COUNT, 3))
"""rad/s."""
ACCEL = np.array([0.12, -0.23, 9.79]) + ACCEL_N * RATE**0.5 * _rng.normal(size=(COUNT, 3))
"""m/s^2."""
STEP = np.arange(COUNT)
T = 12.0 + STEP / RATE
"""s."""
UNIX = 1_700_000_000.0
"""s, the first stamp of those that count from 1970."""
BEGIN = datetime(2024, 3, 19, 9, 44, 16, tzinfo=UTC)


@dataclass(frozen=True)
class PublicFormat:
    """A kind of file.

    Attributes
    ----------
    name : of the program and what it writes.
    source : project that shows the form, and its address.
    file : name of the file.
    text : returns what is in it.
    sensors : that a reader may expect from it without a choice, or from each choice.
    """

    name: str
    source: str
    file: str
    text: Callable[[], str]
    sensors: tuple[str, ...] = ("gyro", "accel")


def rows(*columns: object, header: str = "", sep: str = ",", digits: str = ".9g", end: str = "\n") -> str:
    """Return lines of columns: arrays (n,), (n, k), or one text for all rows."""
    cells: list[list[str]] = []
    for column in columns:
        if isinstance(column, str):
            cells.append([column] * COUNT)
        elif isinstance(column, list):
            cells.append(column)
        else:
            array = np.asarray(column)
            for one in array.reshape(len(array), -1).T:
                whole = np.issubdtype(array.dtype, np.integer)
                cells.append([str(int(v)) if whole else format(float(v), digits) for v in one])
    lines = [sep.join(row) for row in zip(*cells, strict=True)]
    return f"{header}{end}" * bool(header) + end.join(lines) + end


def dates(form: str, cut: int = 0) -> list[str]:
    """Return the times as dates of a form; of its last digits some are cut."""
    texts = [(BEGIN + timedelta(seconds=k / RATE)).strftime(form) for k in range(COUNT)]
    return [text[:-cut] if cut else text for text in texts]


def us(start: float = 12.0) -> np.ndarray:
    return np.rint((start + STEP / RATE) * 1e6).astype(np.int64)


def ns(start: float = UNIX) -> np.ndarray:
    return (int(start) * 10**9 + STEP * 10_000_000).astype(np.int64)


def _by_sensor(line: Callable[[str, int, np.ndarray], str], preamble: Sequence[str] = ()) -> str:
    """Return rows of an accelerometer and of a gyroscope in turn."""
    lines = list(preamble)
    for k in range(COUNT):
        lines += [line("accel", k, ACCEL[k]), line("gyro", k, GYRO[k])]
    return "\n".join(lines) + "\n"


GNSS_HEADER = (
    "# ", "# Header Description:", "# ",
    "# Raw,utcTimeMillis,TimeNanos,LeapSecond,FullBiasNanos,BiasNanos,Svid,State,Cn0DbHz",
    "# ", "# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,"
    "BiasXMps2,BiasYMps2,BiasZMps2",
    "# ", "# UncalGyro,utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,"
    "UncalGyroZRadPerSec,DriftXRadPerSec,DriftYRadPerSec,DriftZRadPerSec", "# ",
)  # fmt: skip


def _gnss_logger() -> str:
    def line(sensor: str, k: int, v: np.ndarray) -> str:
        name = {"accel": "UncalAccel", "gyro": "UncalGyro"}[sensor]
        return f"{name},{1_700_000_000_000 + 10 * k},{10**13 + k * 10_000_000 + (sensor == 'gyro') * 3000},{v[0]:.7f},{v[1]:.7f},{v[2]:.7f},0.0,0.0,0.0"

    return _by_sensor(line, GNSS_HEADER)


def _get_sensor_data() -> str:
    def line(sensor: str, k: int, v: np.ndarray) -> str:
        name = {"accel": "ACCE", "gyro": "GYRO"}[sensor]
        t = 0.03 + k / RATE + (sensor == "gyro") * 1e-3
        return f"{name};{t + 0.002:.3f};{5000 + t:.6f};{v[0]:.6f};{v[1]:.6f};{v[2]:.6f};3"

    return _by_sensor(
        line,
        (
            "% LogFile created by the App 'GetSensorData' for Android", "% Date of creation: Tue Mar 19",
            "% LogFile Data format:",
            "% Accelerometer data: \t'ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy(integer)'",
            "% Gyroscope data:     \t'GYRO;AppTimestamp(s);SensorTimestamp(s);Gyr_X(rad/s);Gyr_Y(rad/s);Gyr_Z(rad/s);Accuracy(integer)'",
            "%",
        ),
    )  # fmt: skip


def _realsense() -> str:
    begin = (
        "\n\nStream Type,F#,HW Timestamp (ms),Backend Timestamp(ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z\n"
    )
    text = ""
    for name, values in (("Gyro", GYRO), ("Accel", ACCEL)):
        text += begin + rows(name, STEP, 1e3 * T, 1e3 * T + 0.7, 1e3 * T + 1.1, values, digits=".10g")
    return text


def _tagged_json() -> str:
    lines = []
    for k in range(COUNT):
        for name, v in (("accelerometer", ACCEL[k]), ("gyroscope", GYRO[k])):
            values = dict(zip("zyx", map(float, v[::-1]), strict=True))
            lines.append({"name": name, "time": str(int(ns()[k])), "values": values})
    return json.dumps({"messageId": 1, "sessionId": "a", "deviceId": "b", "payload": lines})


def _can_json() -> str:
    return json.dumps(
        [
            {
                "linear_accel": a,
                "q": [1.0, 0.0, 0.0, 0.0],
                "rotation_rate": g,
                "utime": 1_531_883_530_449_377 + 10_000 * k,
            }
            for k, (a, g) in enumerate(zip(ACCEL.tolist(), GYRO.tolist(), strict=True))
        ]
    )


def _teleplot() -> str:
    lines = []
    for k in range(COUNT):
        for name, v in zip(("gx", "gy", "gz", "ax", "ay", "az"), (*GYRO[k], *ACCEL[k]), strict=True):
            lines.append(f">{name}:{1_627_551_892_437 + 10 * k}:{v:.7g}")
    return "\n".join(lines) + "\n"


def _own_time_for_each() -> str:
    names = [f"sensor 1: {s}.{a} 1 [{u}]" for s, u in (("ACC", "g"), ("GYRO", "deg/s")) for a in "XYZ"]
    columns = [c for v in np.hstack([ACCEL / G, GYRO / DEG]).T for c in (STEP / RATE, v)]
    return rows(*columns, header=",".join(f"X [s],{name}" for name in names))


def _influx_lines() -> str:
    return "".join(
        f"imu,host=pi gx={g[0]:.7g},gy={g[1]:.7g},gz={g[2]:.7g},ax={a[0]:.7g},ay={a[1]:.7g},az={a[2]:.7g} {t}\n"
        for g, a, t in zip(GYRO, ACCEL, ns(), strict=True)
    )


def _echo_python() -> str:
    return "".join(
        "a/g:\t" + "\t".join(str(int(v)) for v in (*np.rint(a / G * 16384), *np.rint(g / DEG * 131))) + "\n"
        for g, a in zip(GYRO, ACCEL, strict=True)
    )


def _pointwise_german() -> str:
    text = rows(
        STEP / RATE,
        GYRO,
        header='"Time (s)";"Gyroscope x (rad/s)";"Gyroscope y (rad/s)";"Gyroscope z (rad/s)"',
        sep=";",
        digits=".9E",
    )
    header, _, body = text.partition("\n")
    return f"{header}\n{body.replace('.', ',')}"


def _by_topic() -> str:
    """Return rows that each have one topic, as of a program that plots several of them."""
    header = "__time,/imu/angular_velocity/x,/imu/angular_velocity/y,/imu/angular_velocity/z,/imu/linear_acceleration/x,/imu/linear_acceleration/y,/imu/linear_acceleration/z,/odom/pose/pose/position/x"
    lines = [header]
    for k in range(COUNT):
        numbers = ",".join(f"{v:.8g}" for v in (*GYRO[k], *ACCEL[k]))
        lines.append(f"{UNIX + k / RATE:.6f},{numbers},")
        if k % 5 == 0:
            lines.append(f"{UNIX + k / RATE + 0.004:.6f},,,,,,,0.1")
    return "\n".join(lines) + "\n"


def _novatel() -> str:
    """Return increments of an HG4930: 2^-33 rad and 2^-29 m/s."""
    lines = []
    for k, (g, a) in enumerate(zip(GYRO / RATE * 2.0**33, ACCEL / RATE * 2.0**29, strict=True)):
        numbers = ",".join(str(round(v)) for v in (a[2], -a[1], a[0], g[2], -g[1], g[0]))
        time = f"{300_000 + k / RATE:.3f}"
        lines.append(f"%RAWIMUSXA,2200,{time};00,58,2200,{time}000000,00000000,{numbers}*595b19cf")
    return "\n".join(lines) + "\n"


FORMATS = (
    PublicFormat("phyphox, CSV", "phyphox, https://phyphox.org", "Raw Data.csv",
        lambda: rows(STEP / RATE, GYRO, STEP * 0 + 0.01, header='"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)","Absolute (rad/s)"'), ("gyro",)),
    PublicFormat("phyphox, decimal comma", "phyphox, https://phyphox.org", "Raw Data.csv", _pointwise_german, ("gyro",)),
    PublicFormat("Sensor Logger, a file for each sensor", "sensor-logger, https://github.com/tszheichoi/awesome-sensor-logger", "Gyroscope.csv",
        lambda: rows(ns(), STEP / RATE, GYRO[:, ::-1], header="time,seconds_elapsed,z,y,x"), ("gyro",)),
    PublicFormat("Sensor Logger, accelerometer with gravity", "sensor-logger, https://github.com/tszheichoi/awesome-sensor-logger", "TotalAcceleration.csv",
        lambda: rows(ns(), STEP / RATE, ACCEL[:, ::-1], header="time,seconds_elapsed,z,y,x"), ("accel",)),
    PublicFormat("Sensor Logger, JSON pushed by HTTP", "sensor-logger, https://github.com/tszheichoi/awesome-sensor-logger", "push.json", _tagged_json),
    PublicFormat("Physics Toolbox", "Physics Toolbox Sensor Suite, https://www.vieyrasoftware.net", "2024-03-19.csv",
        lambda: rows(STEP / RATE, ACCEL / G, GYRO, header="time,gFx,gFy,gFz,wx,wy,wz", digits=".6f")),
    PublicFormat("Physics Toolbox, time of day", "Physics Toolbox Sensor Suite, https://www.vieyrasoftware.net", "2024-03-19b.csv",
        lambda: rows(dates("%H:%M:%S:%f", 3), ACCEL / G, GYRO, header="time,gFx,gFy,gFz,wx,wy,wz", digits=".6f")),
    PublicFormat("Beiwe accelerometer", "Beiwe, https://github.com/onnela-lab/beiwe-backend", "2024.csv",
        lambda: rows((us(UNIX) // 1000), dates("%Y-%m-%dT%H:%M:%S.%f", 3), "unknown", ACCEL / G, header="timestamp,UTC time,accuracy,x,y,z"), ("accel",)),
    PublicFormat("PicoQuake", "PicoQuake, https://github.com/PLab-SI/PicoQuake", "acq.csv",
        lambda: "# PLab PicoQuake Data\n# Time: 2024-04-21 15:54:46.333682, Device: D4E9 (E66)\n# Num. samples: 1200, Duration: 12.0 s\n"
        "# Config: data_rate = 100.0 Hz, filter = 488 Hz, acc_range = 4 g, gyro_range = 250.0 dps\n# Integrity: True, Skipped samples: 0\n"
        + rows(STEP + 1, ACCEL / G, GYRO / DEG, header="count,a_x,a_y,a_z,g_x,g_y,g_z")),
    PublicFormat("GnssLogger", "gps-measurement-tools, https://github.com/google/gps-measurement-tools", "gnss_log.txt", _gnss_logger),
    PublicFormat("GetSensorData", "GetSensorData suite, https://gitlab.com/getsensordatasuite", "logfile.txt", _get_sensor_data),
    PublicFormat("RealSense recorder", "librealsense, https://github.com/IntelRealSense/librealsense", "data.csv", _realsense),
    PublicFormat("nuScenes CAN bus", "nuscenes-devkit, https://github.com/nutonomy/nuscenes-devkit", "scene_ms_imu.json", _can_json),
    PublicFormat("Open Movement resampled", "openmovement, https://github.com/digitalinteraction/openmovement", "ax6.csv",
        lambda: rows(dates("%Y-%m-%d %H:%M:%S.%f", 3), ACCEL / G, GYRO / DEG,
            header="Time,Accel-X (g), Accel-Y (g), Accel-Z (g), Gyro-X (d/s), Gyro-Y (d/s), Gyro-Z (d/s)")),
    PublicFormat("Gyroflow log", "gyroflow, https://docs.gyroflow.xyz", "clip.gcsv",
        lambda: "GYROFLOW IMU LOG\nversion,1.3\nid,custom_logger\norientation,YxZ\ntscale,0.001\ngscale,0.00006103515625\nascale,0.00048828125\n"
        + rows(10 * STEP, np.rint(GYRO / 0.00006103515625).astype(int), np.rint(ACCEL / G / 0.00048828125).astype(int), header="t,gx,gy,gz,ax,ay,az")),
    PublicFormat("ActiGraph GT9X", "GGIR, https://github.com/wadpac/GGIR", "NEO.csv",
        lambda: "------------ Data File Created By ActiGraph GT9X Link ActiLife v6.13.4 Firmware v1.9.2 date format M/d/yyyy at 100 Hz  Filter Normal -----------\n"
        "Serial Number: NEO123\nStart Time 10:00:00\nStart Date 1/15/2024\nEpoch Period (hh:mm:ss) 00:00:00\nDownload Time 11:00:00\nDownload Date 1/15/2024\n"
        "Current Memory Address: 0\nCurrent Battery Voltage: 4.19     Mode = 61\n--------------------------------------------------\n"
        + rows(dates("%Y-%m-%dT%H:%M:%S.%f0"), ACCEL / G, STEP * 0 + 25.0, GYRO / DEG,
            header="Timestamp,Accelerometer X,Accelerometer Y,Accelerometer Z,Temperature,Gyroscope X,Gyroscope Y,Gyroscope Z")),
    PublicFormat("OpenBCI", "OpenBCI_GUI, https://github.com/OpenBCI/OpenBCI_GUI", "OpenBCI-RAW.txt",
        lambda: "%OpenBCI Raw EXG Data\n%Number of channels = 4\n%Sample Rate = 100 Hz\n%Board = OpenBCI_GUI$BoardCytonSerial\n"
        + rows(STEP % 256, _rng.normal(0, 50, (COUNT, 8)), ACCEL / G, STEP * 0.0, UNIX + STEP / RATE, dates("%Y-%m-%d %H:%M:%S.%f", 3),
            header="Sample Index, " + ", ".join(f"EXG Channel {k}" for k in range(8)) + ", Accel Channel 0, Accel Channel 1, Accel Channel 2, Other, Timestamp, Timestamp (Formatted)", sep=", ", digits=".15g"), ("accel",)),
    PublicFormat("Movella DOT app", "opensim-core 3956, https://github.com/opensim-org/opensim-core/issues/3956", "dot.csv",
        lambda: "sep=,\nDeviceTag:,D1\nFirmwareVersion:,2.0.0\nOutputRate:,100Hz\n"
        + rows(STEP, us(192.0), ACCEL, GYRO / DEG, header="PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z", digits=".7g")),
    PublicFormat("Movella DOT app, no rate", "opensim-core 3956, https://github.com/opensim-org/opensim-core/issues/3956", "dot2.csv",
        lambda: rows(STEP, us(192.0), ACCEL, GYRO / DEG, header="PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z", digits=".7g")),
    PublicFormat("MT Manager", "opensim-core 2812, https://github.com/opensim-org/opensim-core/issues/2812", "MT_0120.txt",
        lambda: "// Start Time: Unknown\n// Sample rate: 100.0Hz\n// Scenario: 4.9\n// Firmware Version: 4.0.2\n"
        + rows(STEP, us(1.0) // 100, " ", ACCEL, GYRO, header="PacketCounter\tSampleTimeFine\tYear\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z", sep="\t")),
    PublicFormat("ulog2csv sensor_combined", "pyulog, https://github.com/PX4/pyulog", "log_sensor_combined_0.csv",
        lambda: rows(us(), GYRO, STEP * 0 + 10000, STEP * 0, ACCEL, STEP * 0 + 10000, STEP * 0,
            header="timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_timestamp_relative,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2],accelerometer_integral_dt,accelerometer_clipping")),
    PublicFormat("ulog2csv vehicle_imu", "pyulog, https://github.com/PX4/pyulog", "log_vehicle_imu_0.csv",
        lambda: rows(us() + 300, us(), "2490378", "2490379", GYRO / RATE, ACCEL / RATE, STEP * 0 + 10000, STEP * 0 + 10000, STEP * 0,
            header="timestamp,timestamp_sample,accel_device_id,gyro_device_id,delta_angle[0],delta_angle[1],delta_angle[2],delta_velocity[0],delta_velocity[1],delta_velocity[2],delta_angle_dt,delta_velocity_dt,delta_angle_clipping")),
    PublicFormat("ulog2csv sensor_gyro", "pyulog, https://github.com/PX4/pyulog", "log_sensor_gyro_0.csv",
        lambda: rows(us() + 300, us(), "2490379", GYRO, STEP * 0 + 41.5, STEP * 0, STEP * 0, STEP * 0, STEP * 0, STEP * 0 + 8,
            header="timestamp,timestamp_sample,device_id,x,y,z,temperature,error_count,clip_counter[0],clip_counter[1],clip_counter[2],samples"), ("gyro",)),
    PublicFormat("mavlogdump IMU", "pymavlink, https://github.com/ArduPilot/pymavlink", "imu.csv",
        lambda: "timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz\n" + "".join(
            f"{UNIX + k / RATE:.6f},{int(65_000_000 + k * 10_000)},{i},{g[0]:.8f},{g[1]:.8f},{g[2]:.8f},{a[0]:.7f},{a[1]:.7f},{a[2]:.7f},0,0,28.8,1,1,1000,1000\n"
            for k in range(COUNT) for i, (g, a) in enumerate(((GYRO[k], ACCEL[k]), (GYRO[k] + 0.02, ACCEL[k] + 0.3))))),
    PublicFormat("blackbox_decode with units", "blackbox-tools, https://github.com/iNavFlight/blackbox-tools", "LOG00001.01.csv",
        lambda: rows(STEP, us(), STEP * 0, STEP * 0, STEP * 0, GYRO / DEG, ACCEL / G,
            header="loopIteration, time (us), axisP[0], axisP[1], axisP[2], gyroADC[0] (deg/s), gyroADC[1] (deg/s), gyroADC[2] (deg/s), accSmooth[0] (g), accSmooth[1] (g), accSmooth[2] (g)", sep=", ")),
    PublicFormat("rostopic echo -p", "rostopic, https://github.com/ros/ros_comm", "imu.csv",
        lambda: rows(ns() + 70, STEP, ns(), GYRO, ACCEL,
            header="%time,field.header.seq,field.header.stamp,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z")),
    PublicFormat("MARS logger", "mobile-ar-sensor-logger, https://github.com/OSUPCVLab/mobile-ar-sensor-logger", "gyro_accel.csv",
        lambda: rows(ns(), GYRO, ACCEL, header="Timestamp[nanosec], gx[rad/s], gy[rad/s], gz[rad/s], ax[m/s^2], ay[m/s^2], az[m/s^2]")),
    PublicFormat("event camera data set", "UZH-FPV data set, https://fpv.ifi.uzh.ch", "imu.txt",
        lambda: rows(UNIX + STEP / RATE, GYRO, ACCEL, header="# timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z", sep=" ", digits=".16g")),
    PublicFormat("event camera data set, no header", "DAVIS data set, https://rpg.ifi.uzh.ch/davis_data.html", "imu.txt",
        lambda: rows(STEP / RATE, ACCEL, GYRO, sep=" ")),
    PublicFormat("Trigno, a time for each column", "Delsys, https://delsys.com", "trial.csv", _own_time_for_each),
    PublicFormat("can_data of an INS", "python-openimu, https://github.com/Aceinna/python-openimu", "data.csv",
        lambda: rows(STEP / RATE, GYRO / DEG, ACCEL, header="time,xRate,yRate,zRate,xAccel,yAccel,zAccel")),
    PublicFormat("PlotJuggler", "PlotJuggler, https://github.com/facontidavide/PlotJuggler", "plot.csv", _by_topic),
    PublicFormat("Inertial Sense IMU", "inertial-sense-sdk, https://github.com/inertialsense/inertial-sense-sdk", "LOG_IMU.csv",
        lambda: rows(STEP / RATE, GYRO, ACCEL, STEP * 0, header="time,I.pqr[0],I.pqr[1],I.pqr[2],I.acc[0],I.acc[1],I.acc[2],status")),
    PublicFormat("Inertial Sense PIMU", "inertial-sense-sdk, https://github.com/inertialsense/inertial-sense-sdk", "LOG_PIMU.csv",
        lambda: rows(STEP / RATE, GYRO / RATE, ACCEL / RATE, STEP * 0 + 0.01, STEP * 0, header="time,theta[0],theta[1],theta[2],vel[0],vel[1],vel[2],dt,status")),
    PublicFormat("SBG logger", "sbgECom, https://github.com/SBG-Systems/sbgECom", "imuData.csv",
        lambda: "timestamp,status,accelX,accelY,accelZ,gyroX,gyroY,gyroZ,temp,deltaVelX,deltaVelY,deltaVelZ,deltaAngleX,deltaAngleY,deltaAngleZ\n"
        "(us),(na),(m.s^-2),(m.s^-2),(m.s^-2),(deg.s^-1),(deg.s^-1),(deg.s^-1),(degC),(m.s^-2),(m.s^-2),(m.s^-2),(deg.s^-1),(deg.s^-1),(deg.s^-1)\n"
        + rows(us(), STEP * 0, ACCEL, GYRO / DEG, STEP * 0 + 31.0, ACCEL, GYRO / DEG)),
    PublicFormat("x-IMU3", "x-IMU3-Software, https://github.com/xioTechnologies/x-IMU3-Software", "Inertial.csv",
        lambda: rows(us(), GYRO / DEG, ACCEL / G, header="Timestamp (us),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)")),
    PublicFormat("NGIMU", "NGIMU import example, https://github.com/xioTechnologies/NGIMU-MATLAB-Import-Logged-Data-Example", "sensors.csv",
        lambda: rows(STEP / RATE, GYRO / DEG, ACCEL / G, GYRO * 0 + 20.0, STEP * 0 + 1013.0, header="Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g),Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT),Barometer (hPa)")),
    PublicFormat("MPU6050_raw of i2cdevlib", "i2cdevlib, https://github.com/jrowberg/i2cdevlib", "serial.txt", _echo_python),
    PublicFormat("Teleplot", "teleplot, https://github.com/nesnes/teleplot", "teleplot.txt", _teleplot),
    PublicFormat("InfluxDB lines", "influxdb, https://github.com/influxdata/influxdb", "imu.lp", _influx_lines),
    PublicFormat("gopro-telemetry CSV", "gopro-telemetry, https://github.com/JuanIrache/gopro-telemetry", "GYRO.csv",
        lambda: rows(1e3 * STEP / RATE, dates("%Y-%m-%dT%H:%M:%S.%fZ"), GYRO[:, [2, 0, 1]], header='"cts","date","Gyroscope (z,x,y) [rad/s]","1","2"', digits=".10g"), ("gyro",)),
    PublicFormat("HSDatalog", "stdatalog, https://github.com/STMicroelectronics/stdatalog_examples", "lsm6dsv_gyro.csv",
        lambda: rows(STEP / RATE, GYRO / DEG * 1e3, header="Time,G_x [mdps],G_y [mdps],G_z [mdps]"), ("gyro",)),
    PublicFormat("iSensor FX3 evaluation", "iSensor-FX3-Eval, https://github.com/analogdevicesinc/iSensor-FX3-Eval", "burst.csv",
        lambda: rows(STEP, np.rint(GYRO / DEG * 160).astype(int), np.rint(ACCEL / G * 4000).astype(int), header="DATA_CNTR,X_GYRO_OUT,Y_GYRO_OUT,Z_GYRO_OUT,X_ACCL_OUT,Y_ACCL_OUT,Z_ACCL_OUT")),
    PublicFormat("DMU of Silicon Sensing", "Silicon Sensing, https://www.siliconsensing.com", "dmu.csv",
        lambda: rows(STEP / RATE, STEP, np.stack([GYRO / DEG, ACCEL / G], axis=2).reshape(COUNT, 6),
            header="Time (s),Message Count," + ",".join(f"Axis {a} Rate (°/s),Axis {a} Acceleration (g)" for a in "XYZ"))),
    PublicFormat("MATLAB timetable", "MATLAB, https://www.mathworks.com/help/matlab/ref/writetimetable.html", "phone.csv",
        lambda: rows(dates("%d-%b-%Y %H:%M:%S.%f", 3), GYRO, header="Timestamp,AngularVelocity_X,AngularVelocity_Y,AngularVelocity_Z"), ("gyro",)),
    PublicFormat("Serial Studio", "Serial-Studio, https://github.com/Serial-Studio/Serial-Studio", "frames.csv",
        lambda: rows(dates("%Y/%m/%d %H:%M:%S::%f", 3), ACCEL, GYRO, header="RX Date/Time,Accelerometer X,Accelerometer Y,Accelerometer Z,Gyro X,Gyro Y,Gyro Z")),
    PublicFormat("gyro-recorder in a browser", "gyro-recorder, https://github.com/koolBEANS829/gyro-recorder", "rec.csv",
        lambda: rows(10 * STEP, GYRO[:, [2, 0, 1]] / DEG, ACCEL, header="Timestamp_ms,Gyro_Alpha,Gyro_Beta,Gyro_Gamma,Accel_X,Accel_Y,Accel_Z")),
    PublicFormat("Mind Monitor", "Mind Monitor, https://mind-monitor.com", "mindMonitor.csv",
        lambda: rows(dates("%Y-%m-%d %H:%M:%S.%f", 3), ACCEL / G, GYRO / DEG, header="TimeStamp,Accelerometer_X,Accelerometer_Y,Accelerometer_Z,Gyro_X,Gyro_Y,Gyro_Z")),
    PublicFormat("KAIST urban data set", "Complex Urban data set, https://sites.google.com/view/complex-urban-dataset", "xsens_imu.csv",
        lambda: rows(ns(), GYRO * 0 + 0.1, STEP * 0 + 1.0, GYRO * 0, GYRO, ACCEL, GYRO * 0 + 0.3)),
    PublicFormat("LabVIEW measurement", "LabVIEW, https://www.ni.com/labview", "run.lvm",
        lambda: "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n***End_of_Header***\t\n\t\nChannels\t3\t\t\t\n"
        "Samples\t1200\t1200\t1200\nX_Dimension\tTime\tTime\tTime\n***End_of_Header***\t\t\t\t\nX_Value\tGyro X\tGyro Y\tGyro Z\tComment\n"
        + rows(STEP / RATE, GYRO, sep="\t"), ("gyro",)),
    PublicFormat("Empatica ACC", "Empatica E4, https://www.empatica.com", "ACC.csv",
        lambda: "1700000000.000000, 1700000000.000000, 1700000000.000000\n100.000000, 100.000000, 100.000000\n" + rows(np.rint(ACCEL / G * 640).astype(int)), ("accel",)),
    PublicFormat("KITTI OXTS", "pykitti, https://github.com/utiasSTARS/pykitti", "0000000000.txt",
        lambda: " ".join(f"{v:.9g}" for v in np.r_[49.0, 8.4, 112.8, 0.0, 0.0, 0.0, np.zeros(5), ACCEL[0], ACCEL[0], GYRO[0], GYRO[0], 0.5, 0.1, 4, 10, 5, 5, 5]) + "\n"),
    PublicFormat("NovAtel RAWIMUSXA", "OEM7 manual, https://docs.novatel.com/OEM7", "imu.asc", _novatel),
)  # fmt: skip


WITHIN = 0.2
"""Share by which the white noise of 1200 samples may differ from the true one."""

ONE_SENSOR = (
    "GnssLogger",
    "GetSensorData",
    "RealSense recorder",
    "iSensor FX3 evaluation",
    "Inertial Sense PIMU",
)
"""Formats of which the proposal has one of both sensors."""

OWNER = (
    "MPU6050_raw of i2cdevlib",
    "Empatica ACC",
    "KITTI OXTS",
    "NovAtel RAWIMUSXA",
    "iSensor FX3 evaluation",
)
"""Formats of which only the owner knows the size of a count, or that have one row."""


def faults(form: PublicFormat, path: Path, **options: object) -> list[str]:
    """Return what is wrong with the samples of a file; raise `ImumonError` if it is not read."""
    recording = open_recording(str(path), ReadOptions(**options))  # type: ignore[arg-type]
    blocks = [block for some in recording for block in some if isinstance(block, SampleBlock)]
    values, channels = np.concatenate([block.values for block in blocks]), blocks[0].stream.channels
    wrong = []
    for sensor, noise in (("gyro", GYRO_N), ("accel", ACCEL_N)):
        for axis, true in zip("xyz", noise, strict=True):
            if f"{sensor}/{axis}" in channels:
                column = values[:, channels.index(f"{sensor}/{axis}")]
                ratio = np.diff(column).std() / 2.0**0.5 / RATE**0.5 / true
                wrong += [f"{sensor}/{axis} {ratio:.3g}"] * bool(abs(ratio - 1.0) > WITHIN)
            elif sensor in form.sensors and form.name not in ONE_SENSOR:
                wrong.append(f"no {sensor}/{axis}")
    return wrong


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_public_format_is_read_right_or_asked(tmp_path: Path, form: PublicFormat) -> None:
    path = tmp_path / form.file
    path.write_text(form.text())
    code = ""
    try:
        wrong = faults(form, path)
    except ImumonError as error:
        wrong, code = [], error.code
    assert not wrong
    assert code in ("", "columns_unclear", "no_sensor")
    if code and form.name not in OWNER:
        assert not faults(form, path, accept=True)
