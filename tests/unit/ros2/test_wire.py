"""Keys, tokens and attachments, compared with those of a recorded robot."""

import json
from pathlib import Path
from typing import Any

import pytest

from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import CDR_HEADER, decode, encode, type_hash
from clustermcl.ros2.wire import (
    HUMBLE_HASH,
    EndpointKind,
    NodeName,
    Qos,
    attachment,
    data_key,
    endpoint_id,
    hash_in_token,
    node_in_token,
    parsed_attachment,
)

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "golden_jazzy.json").read_text())
"""Recorded from rclpy 7.1.6 over rmw_zenoh_cpp 0.2.10 (Jazzy): a node `/robot` of domain 0."""
SESSION = "4e456e91a7e57c7136cb3787329f8d64"
ROBOT = NodeName(0, "", "robot")

PUB, SUB, CLIENT = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER, EndpointKind.CLIENT
LATCHED, BEST_EFFORT = Qos(depth=1, latched=True), Qos(depth=5, best_effort=True)
ENDPOINTS = {
    10: (PUB, "/map", types.OCCUPANCY_GRID, LATCHED),
    11: (PUB, "/tf_static", types.TF_MESSAGE, LATCHED),
    12: (PUB, "/tf", types.TF_MESSAGE, Qos(depth=100)),
    13: (PUB, "/scan", types.LASER_SCAN, BEST_EFFORT),
    14: (PUB, "/initialpose", types.POSE_STAMPED, Qos()),
    15: (PUB, "/clock", types.CLOCK, Qos(depth=1, best_effort=True)),
    16: (CLIENT, "/amcl/get_state", types.GET_STATE, Qos()),
    17: (CLIENT, "/amcl/get_available_transitions", types.GET_AVAILABLE_TRANSITIONS, Qos()),
    18: (CLIENT, "/amcl/get_available_states", types.GET_AVAILABLE_STATES, Qos()),
    19: (SUB, "/amcl/transition_event", types.TRANSITION_EVENT, Qos()),
    20: (CLIENT, "/amcl/change_state", types.CHANGE_STATE, Qos()),
    21: (PUB, "/bond", types.BOND_STATUS, Qos(depth=5)),
    22: (SUB, "/bond", types.BOND_STATUS, Qos(depth=100)),
    23: (SUB, "/tf", types.TF_MESSAGE, Qos(depth=100)),
    24: (SUB, "/particle_cloud", types.PARTICLE_CLOUD, BEST_EFFORT),
    25: (SUB, "/amcl/hypotheses", types.MARKER_ARRAY, LATCHED),
    26: (SUB, "/diagnostics", types.DIAGNOSTIC_ARRAY, Qos()),
    60: (CLIENT, "/set_initial_pose", types.SET_INITIAL_POSE, Qos()),
    61: (CLIENT, "/reinitialize_global_localization", types.EMPTY, Qos()),
    62: (CLIENT, "/request_nomotion_update", types.EMPTY, Qos()),
}


def token(number: int, *, humble: bool = False, name: NodeName = ROBOT) -> str:
    kind, topic, ros_type, qos = ENDPOINTS[number]
    hashed = type_hash(ros_type, humble=humble)
    return name.endpoint_token(SESSION, number, kind, topic, ros_type, hashed, qos)


def first_samples() -> dict[str, dict[str, Any]]:
    return {key: about["first"][0] for key, about in GOLDEN["samples"].items()}


def test_the_tokens_are_those_of_the_recorded_robot() -> None:
    assert [ROBOT.token(SESSION), *map(token, ENDPOINTS)] == GOLDEN["tokens"]


def test_the_keys_are_those_of_the_recorded_robot() -> None:
    published = {(ENDPOINTS[number][1], ENDPOINTS[number][2]) for number in (10, 11, 12, 13, 14)}
    keys = {data_key(0, topic, kind, type_hash(kind, humble=False)) for topic, kind in published}
    assert keys == set(first_samples())


@pytest.mark.parametrize("number", [10, 11, 12, 13, 14])
def test_the_id_in_an_attachment_is_the_hash_of_its_publishers_token(number: int) -> None:
    _, topic, ros_type, _ = ENDPOINTS[number]
    key = data_key(0, topic, ros_type, type_hash(ros_type, humble=False))
    recorded = bytes.fromhex(first_samples()[key]["attachment"])
    sequence, time_ns, sender = parsed_attachment(recorded)
    assert (sequence, sender) == (1, endpoint_id(token(number)))
    assert attachment(sequence, time_ns, sender) == recorded


@pytest.mark.parametrize("number", [11, 12, 14])
def test_recorded_messages_are_read_and_written_alike(number: int) -> None:
    _, topic, ros_type, _ = ENDPOINTS[number]
    key = data_key(0, topic, ros_type, type_hash(ros_type, humble=False))
    recorded = bytes.fromhex(first_samples()[key]["payload"])
    message = decode(recorded, ros_type)
    again = encode(message, ros_type)
    assert len(again) == len(recorded)
    assert encode(decode(again, ros_type), ros_type) == again
    # ROS leaves what was in memory between the fields; we write zeros.
    differing = [i for i, (a, b) in enumerate(zip(again, recorded, strict=True)) if a != b]
    assert all(again[i] == 0 for i in differing)
    assert len(differing) <= 8


def test_the_recorded_scan_is_read() -> None:
    key = next(key for key in first_samples() if "LaserScan" in key)
    payload = bytes.fromhex(first_samples()[key]["payload"])
    scan = decode(payload, types.LASER_SCAN)
    assert (scan.header.frame_id, len(scan.ranges)) == ("laser", 301)
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1.5, 1.5, 30.0)
    assert scan.ranges[0] == 2.0


def test_humble_has_a_constant_in_place_of_each_hash() -> None:
    for number, recorded in zip(ENDPOINTS, GOLDEN["tokens"][1:], strict=True):
        chunks = recorded.split("/")
        assert chunks[11].startswith("RIHS01_")
        chunks[11] = HUMBLE_HASH
        assert token(number, humble=True) == "/".join(chunks)
        assert hash_in_token("/".join(chunks)) == HUMBLE_HASH


def test_the_hash_in_a_token_is_found_if_newer_releases_append_parts() -> None:
    assert hash_in_token(GOLDEN["tokens"][1]) == type_hash(types.OCCUPANCY_GRID, humble=False)
    assert hash_in_token(GOLDEN["tokens"][1] + "/more/still") == hash_in_token(GOLDEN["tokens"][1])
    assert hash_in_token(GOLDEN["tokens"][0]) is None
    assert hash_in_token("robot/pose") is None


def test_a_namespace_is_part_of_keys_and_tokens() -> None:
    amcl = NodeName(7, "/robot1", "amcl")
    assert amcl.topic("scan") == "/robot1/scan"
    assert amcl.topic("/tf") == "/tf"
    assert amcl.topic("~/get_state") == "/robot1/amcl/get_state"
    key = data_key(7, amcl.topic("scan"), types.CLOCK, "*")
    assert key == "7/robot1/scan/rosgraph_msgs::msg::dds_::Clock_/*"
    assert amcl.token("abc") == "@ros2_lv/7/abc/0/0/NN/%/%robot1/amcl"
    assert node_in_token(amcl.token("abc")) == "/robot1/amcl"
    assert node_in_token(GOLDEN["tokens"][0]) == "/robot"
    assert node_in_token(GOLDEN["tokens"][1]) is None


def test_an_attachment_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="32 bytes, not 33"):
        parsed_attachment(bytes(32))
    with pytest.raises(ValueError, match="an id of 0 bytes"):
        parsed_attachment(bytes(33))


def test_an_empty_request_is_five_bytes() -> None:
    empty = encode(types.new(types.request_of(types.EMPTY)), types.request_of(types.EMPTY))
    assert empty == CDR_HEADER + b"\0"
