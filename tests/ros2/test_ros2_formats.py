"""ROS 2 wire formats: the vectors of the design document of rmw_zenoh, and other people's encoders and decoders."""

from __future__ import annotations

import contextlib
import hashlib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ros2_messages import decode, encode, header

from imumon.ros2.node import RosError, TopicPublisher
from imumon.ros2.ros_messages import (
    DIAGNOSTIC_ARRAY,
    IMU,
    MAGNETIC_FIELD,
    TEMPERATURE,
    CdrError,
    imu_message,
    type_hash,
    with_imu_covariances,
)
from imumon.ros2.topic_keys import (
    RELIABLE,
    SENSOR_DATA,
    Attachment,
    entity_token,
    gid_of,
    node_token,
    parse_attachment,
    parse_token,
    topic_key,
)
from imumon.ros2.topic_url import absent_topic, parse_url

STAMP_NS = 1_700_000_000_123_456_789
DIAGONAL = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


IMU_FIELDS: dict[str, Any] = {
    "header": header(STAMP_NS, "imu_link"),
    "orientation": {**xyz(0.0, 0.0, 0.0), "w": 1.0},
    "orientation_covariance": [-1.0, *[0.0] * 8],
    "angular_velocity": xyz(0.001, -0.002, 0.003),
    "angular_velocity_covariance": [1e-6 * each for each in DIAGONAL],
    "linear_acceleration": xyz(0.25, -0.5, -9.8125),
    "linear_acceleration_covariance": [1e-4 * each for each in DIAGONAL],
}
TEMPERATURE_FIELDS = {"header": header(STAMP_NS, "imu_link"), "temperature": 25.5, "variance": 0.0}
TEMPERATURE_BYTES = (
    "00 01 00 00 00 f1 53 65 15 cd 5b 07 09 00 00 00 69 6d 75 5f 6c 69 6e 6b 00 00 00 00"
    "00 00 00 00 00 80 39 40 00 00 00 00 00 00 00 00"
)
DIAGNOSTIC_FIELDS = {
    "header": header(STAMP_NS),
    "status": [
        {
            "level": 0,
            "name": "imumon: gyro",
            "message": "industrial",
            "hardware_id": "0100056785",
            "values": [{"key": "grade", "value": "industrial"}],
        }
    ],
}
DIAGNOSTIC_BYTES = """
    00 01 00 00 00 f1 53 65 15 cd 5b 07 01 00 00 00 00 00 00 00 01 00 00 00 00 00 00 00 0d 00 00 00
    69 6d 75 6d 6f 6e 3a 20 67 79 72 6f 00 00 00 00 0b 00 00 00 69 6e 64 75 73 74 72 69 61 6c 00 00
    0b 00 00 00 30 31 30 30 30 35 36 37 38 35 00 00 01 00 00 00 06 00 00 00 67 72 61 64 65 00 00 00
    0b 00 00 00 69 6e 64 75 73 74 72 69 61 6c 00"""
HASHES = {
    IMU: "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    MAGNETIC_FIELD: "e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
    TEMPERATURE: "72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
    "sensor_msgs/msg/FluidPressure": "22dfb2b145a0bd5a31a1ac3882a1b32148b51d9b2f3bab250290d66f3595bc32",
    DIAGNOSTIC_ARRAY: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "geometry_msgs/msg/Vector3Stamped": "d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
}
MESSAGES = [(IMU, IMU_FIELDS), (TEMPERATURE, TEMPERATURE_FIELDS), (DIAGNOSTIC_ARRAY, DIAGNOSTIC_FIELDS)]


# ---------------------------------------------------------------------- vectors


@pytest.mark.parametrize("name", HASHES)
def test_type_hashes(name: str) -> None:
    assert type_hash(name) == f"RIHS01_{HASHES[name]}"


def test_an_imu_has_the_bytes_of_the_vector() -> None:
    payload = encode(IMU, IMU_FIELDS)
    assert len(payload) == 324
    assert (
        hashlib.sha256(payload).hexdigest()
        == "61f4b54182c27ebeb0b542884dd8ab2dba2a6867de3b8464e7ce4705f4db9a87"
    )
    assert decode(IMU, payload) == IMU_FIELDS
    read = imu_message(payload)
    assert (read.stamp_ns, read.gyro, read.accel) == (STAMP_NS, (0.001, -0.002, 0.003), (0.25, -0.5, -9.8125))


@pytest.mark.parametrize(
    ("name", "fields", "text"),
    [
        (TEMPERATURE, TEMPERATURE_FIELDS, TEMPERATURE_BYTES),
        (DIAGNOSTIC_ARRAY, DIAGNOSTIC_FIELDS, DIAGNOSTIC_BYTES),
    ],
)
def test_other_messages_have_the_bytes_of_the_vectors(name: str, fields: dict[str, Any], text: str) -> None:
    payload = bytes.fromhex(text)
    assert encode(name, fields) == payload
    assert decode(name, payload) == fields


ZID = "aac3178e146ba6f1fc6e6a4085e77f21"
IMU_TYPE = f"sensor_msgs::msg::dds_::Imu_/RIHS01_{HASHES[IMU]}"


def test_key_token_gid_and_attachment_of_the_vector() -> None:
    assert topic_key(0, "/imu/data_cov", IMU, type_hash(IMU)) == f"0/imu/data_cov/{IMU_TYPE}"
    token = entity_token(0, ZID, "imumon", "MP", "/imu/data_cov", IMU, type_hash(IMU), RELIABLE, entity_id=10)
    assert token == f"@ros2_lv/0/{ZID}/0/10/MP/%/%/imumon/%imu%data_cov/{IMU_TYPE}/::,10:,:,:,,"
    assert gid_of(token).hex(" ") == "52 7f 04 b6 35 76 45 98 95 f4 51 e0 bc 2d 00 b7"
    attachment = Attachment(1, STAMP_NS, gid_of(token))
    data = "01 00 00 00 00 00 00 00 15 cd 85 3d fe 9c 97 17 10 " + gid_of(token).hex(" ")
    assert attachment.encode().hex(" ") == data
    assert parse_attachment(bytes.fromhex(data)) == attachment
    assert parse_attachment(bytes.fromhex(data)[:-1]) is None


STRING = "std_msgs/msg/String"
STRING_TYPE = f"std_msgs::msg::dds_::String_/RIHS01_{HASHES[STRING]}"


def test_tokens_of_the_design_document() -> None:
    assert node_token(2, ZID, "listener") == f"@ros2_lv/2/{ZID}/0/0/NN/%/%/listener"
    token = entity_token(
        2, ZID, "listener", "MS", "/chatter", STRING, type_hash(STRING), RELIABLE, entity_id=10
    )
    assert token == f"@ros2_lv/2/{ZID}/0/10/MS/%/%/listener/%chatter/{STRING_TYPE}/::,10:,:,:,,"
    entity = parse_token(token)
    assert (entity.kind, entity.node, entity.topic, entity.type) == ("MS", "/listener", "/chatter", STRING)
    talker = token.replace("MS", "MP").replace("listener", "talker").replace("/::,10", "/2::,5")
    made = entity_token(
        2, ZID, "talker", "MP", "/chatter", STRING, type_hash(STRING), SENSOR_DATA, entity_id=10
    )
    assert made == talker


# ---------------------------------------------------------------------- laws


@settings(max_examples=200)
@given(st.binary(max_size=400))
def test_any_bytes_are_a_message_or_an_error(data: bytes) -> None:
    for payload in (data, b"\0\1\0\0" + data, b"\0\0\0\0" + data):
        for name, _ in MESSAGES:
            with contextlib.suppress(CdrError):
                decode(name, payload)
        with contextlib.suppress(CdrError):
            imu_message(payload)


def test_big_endian_messages_are_read() -> None:
    import struct

    body = struct.pack(">iII4s", 5, 6, 1, b"\0") + struct.pack(">37d", *range(37))
    assert imu_message(b"\0\0\0\0" + body).stamp_ns == 5_000_000_006
    assert imu_message(b"\0\0\0\0" + body).gyro == (13.0, 14.0, 15.0)


def test_covariances_replace_those_of_the_input() -> None:
    payload = with_imu_covariances(encode(IMU, IMU_FIELDS), [1.0, 2.0, 3.0], None)
    fields = decode(IMU, payload)
    assert fields["angular_velocity_covariance"] == [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0]
    changed = {"angular_velocity_covariance"}
    assert all(fields[name] == IMU_FIELDS[name] for name in IMU_FIELDS if name not in changed)


# ---------------------------------------------------------------------- URLs and messages for people


def test_a_url_overrides_the_settings() -> None:
    class Table:
        domain, router = 5, "tcp/10.0.0.1:7447"

    assert parse_url("ros2:/imu", Table).domain == 5
    url = parse_url(
        "ros2:/imu/data?rmw=zenoh&domain=3&router=tcp/[::1]:7448&accel=/a&mag=m&temperature=/t", Table
    )
    assert (url.topic, url.domain, url.router) == ("/imu/data", 3, "tcp/[::1]:7448")
    assert (url.accel, url.mag, url.temperature) == ("/a", "/m", "/t")


@pytest.mark.parametrize(
    "url",
    [
        "ros2:/imu data",
        "ros2:/imu//data",
        "ros2:/imu/data/",
        "ros2:/imu/*",
        "ros2:/imu?domain=x",
        "ros2:/imu?domain=233",
        "ros2:/imu?domain=",
        "ros2:/imu?rmw=fastdds",
        "ros2:/imu?router=localhost",
        "ros2:/imu?topic=/x",
        "ros2:/imu?domain",
        "ros2:/imu?accel=",
    ],
)
def test_a_wrong_url_is_an_error_with_a_cure(url: str) -> None:
    with pytest.raises(RosError) as caught:
        parse_url(url)
    assert caught.value.cure


def test_an_absent_topic_names_what_there_is() -> None:
    url = parse_url("ros2:/imu")
    others = {TopicPublisher("/a", IMU, "/n"), TopicPublisher("/b", STRING, "/n")}
    assert "IMU topics: /a:" in str(absent_topic(url, others))
    assert absent_topic(url, {TopicPublisher("/imu", STRING, "/n")}).code == "ros2_topic_type"
    assert "1 topic, none" in str(absent_topic(url, {TopicPublisher("/b", STRING, "/n")}))
    assert "RMW_IMPLEMENTATION" in str(absent_topic(url, set()))
