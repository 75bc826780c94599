"""The package as colcon builds it (ament_python)."""

from glob import glob

from setuptools import setup

NAME = "revisit_ros"

setup(
    name=NAME,
    version="0.4.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.xml"))),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The revisit developers",
    maintainer_email="revisit@example.org",
    description="Visual place recognition for ROS 2, by a revisit service",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "localize = revisit_ros.localize_node:main",
            "enroll = revisit_ros.enroll_node:main",
        ]
    },
)
