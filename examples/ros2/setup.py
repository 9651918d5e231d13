"""Installs the node where colcon and `ros2 run` look for it."""

from setuptools import setup

NAME = "ttus_wrench"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools", "ttus-opt"],
    zip_safe=True,
    entry_points={
        "console_scripts": [
            f"wrench_node = {NAME}.wrench_node:main",
            f"follower_node = {NAME}.follower_node:main",
        ]
    },
)
