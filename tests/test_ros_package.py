"""The package for a ROS 2 workspace, as far as it can be checked without ROS."""

from __future__ import annotations

import importlib.util
import sys
import types
from collections.abc import Mapping
from typing import Any

import pytest
from paths import ROOT

from imumon.cli import parsers
from imumon.ros2.topic_url import parse_url

PACKAGE = ROOT / "ros" / "imumon_ros"


class Recorded:
    """Stands for a class of launch; keeps what it is made with."""

    def __init__(self, *words: Any, **options: Any) -> None:
        self.words, self.options = words, options

    def perform(self, context: Mapping[str, str]) -> str:
        return context[self.words[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The launch file as a module, with stubs of launch."""
    for name in ("launch", "launch.actions", "launch.substitutions"):
        stub: Any = types.ModuleType(name)
        for each in (
            "LaunchDescription",
            "DeclareLaunchArgument",
            "ExecuteProcess",
            "OpaqueFunction",
            "LaunchConfiguration",
        ):
            setattr(stub, each, Recorded)
        monkeypatch.setitem(sys.modules, name, stub)
    monkeypatch.syspath_prepend(str(PACKAGE))
    spec = importlib.util.spec_from_file_location("imumon_launch", PACKAGE / "launch" / "imumon.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def defaults(module: Any, **values: str) -> dict[str, str]:
    return {name: values.get(name, default) for name, (default, _) in module.ARGUMENTS.items()}


def test_the_launch_file_starts_a_command_that_exists(
    launch_file: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    description = launch_file.generate_launch_description()
    declared = {each.words[0] for each in description.words[0] if each.words}
    assert declared == set(launch_file.ARGUMENTS)
    values = defaults(
        launch_file,
        topic="/a",
        accel="/b",
        router="tcp/10.0.0.1:7447",
        diagnostics="true",
        state="/tmp/x",
    )
    (process,) = launch_file.start(values)
    program, *words = process.options["cmd"]
    assert program == "imumon"
    parsed = parsers()[0].parse_args(words)
    assert parsed.publish_diagnostics
    url = parse_url(parsed.port)
    assert (url.topic, url.rmw, url.domain) == ("/a", "zenoh", 7)
    assert (url.accel, url.router) == ("/b", "tcp/10.0.0.1:7447")


def test_the_program_passes_on_its_words_without_those_of_ros(launch_file: Any) -> None:
    from imumon_ros.monitor import without_ros_arguments

    words = ["/imu", "--ros-args", "-r", "__node:=x", "--", "--json", "--ros-args", "-p", "a:=b"]
    assert without_ros_arguments(words) == ["/imu", "--json"]


def test_the_manifest_is_valid() -> None:
    catkin = pytest.importorskip("catkin_pkg.package", reason="catkin-pkg is not installed (extra peers)")
    package = catkin.parse_package(str(PACKAGE))
    package.validate()
    assert (package.name, package.get_build_type()) == ("imumon_ros", "ament_python")
