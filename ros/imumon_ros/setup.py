"""Installs the package into a ROS 2 workspace: colcon build --packages-select imumon_ros."""

from glob import glob
from xml.etree import ElementTree

from setuptools import setup

NAME = "imumon_ros"

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").getroot().findtext("version"),
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],  # imumon itself: pip install imumon
    zip_safe=True,
    license="Apache-2.0",
    description="Starts imumon from a launch file",
    entry_points={"console_scripts": [f"monitor = {NAME}.monitor:main"]},
)
