"""What pyproject.toml cannot say: the folder ``profiles`` is also installed, as the data ``cellapp/starters``."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["cellapp*", "drivers*"]), "cellapp.starters"],
    package_dir={"cellapp.starters": "profiles"},
)
