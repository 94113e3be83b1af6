"""Build plate_view as an ament_python package."""

from setuptools import find_packages, setup

from plate_native import node_programs

NAME = "plate_view"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "static/*", "static/*/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["plate_core", "numpy", "opencv-python-headless", "PyYAML", "tornado"],
    extras_require={"test": ["hypothesis", "pytest"]},
    cmdclass={"install_scripts": node_programs("page")},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="A live page that shows the plate and moves parts to where they are dragged.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"page = {NAME}.node:main"]},
)
