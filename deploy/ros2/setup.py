"""Build of the package. The Python package `wsg-gateway` comes from the gateway: rosdep does not know it."""

from glob import glob

from setuptools import setup

NAME = "wsg_gateway_ros"

setup(
    name=NAME,
    version="0.2.0",
    description="Node for a WSG gripper behind a WSG gateway",
    license="MIT",
    packages=[NAME],
    python_requires=">=3.10",
    install_requires=["setuptools", "wsg-gateway"],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", glob("config/*")),
        (f"share/{NAME}/launch", glob("launch/*.py")),
        (f"share/{NAME}/urdf", glob("urdf/*")),
    ],
    entry_points={"console_scripts": [f"gripper = {NAME}.node:main"]},
)
