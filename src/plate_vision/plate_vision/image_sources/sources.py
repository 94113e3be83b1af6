"""Selection of the image source for a device's name, and the list of devices that `camera --list`
prints. The kind of source (V4L2 camera, GenICam camera, pipe, or files) follows from the name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from plate_core.files import kind_of

from .genicam import PREFIX, GenicamSource
from .played import FilmSource, PipeSource
from .source import FORMATS, CameraError, NoImagesError, Settings, Source, Warn
from .v4l2 import V4l2Source
from .v4l2_device import V4l2Device

BY_ID = Path("/dev/v4l/by-id")
"""Folder of links to devices. The name of a link contains the manufacturer and the serial number,
so it does not change when the device is plugged in again."""

ALLOWED = (
    "a number or path of a video device (/dev/v4l/by-id/...), genicam:FILE.cti, a video, a "
    "picture, a folder of pictures, or a pipe"
)


def is_played(device: str) -> bool:
    """Whether a name is the path of a film, a picture or a folder."""
    return kind_of(device) in ("a file", "a folder")


def make_source(settings: Settings, warn: Warn) -> Source:
    """Return the source for a device's name. The source is not open yet.

    Raises
    ------
    CameraError
        If there is no source with this name.
    """
    name = settings.device
    if name.startswith(PREFIX):
        return GenicamSource(settings, warn)
    if name.isdigit() or name.startswith("/dev/"):
        return V4l2Source(settings, warn)
    if is_played(name):
        return FilmSource(settings, warn)
    if kind_of(name) == "a FIFO":
        return PipeSource(settings, warn)
    if kind_of(name) == "a device":
        return V4l2Source(settings, warn)
    missing = "no such device or file" if name else "no device is given"
    raise CameraError(f"{name or 'device'}: {missing}, allowed: {ALLOWED}")


def check_device(device: str) -> None:
    """Raise an error if there is no source with this name, or if it is a video device that cannot
    be opened.

    Raises
    ------
    CameraError
    """
    source = make_source(Settings(device), lambda _: None)
    if isinstance(source, V4l2Source):
        V4l2Device(source.path).close()


def video_devices() -> list[str]:
    """Return the paths of all video devices. If a device has a link in `BY_ID`, the path is this
    link."""
    named = {link.resolve(): link for link in sorted(BY_ID.glob("*")) if link.exists()}
    devices = sorted(Path("/dev").glob("video*"), key=lambda path: (len(path.name), path.name))
    return [str(named.get(device, device)) for device in devices]


def listing(paths: Iterable[str]) -> Iterator[str]:
    """Yield the lines of the list: formats, sizes, rates and controls of each device."""
    count = 0
    for path in paths:
        try:
            device = V4l2Device(path)
        except NoImagesError:
            continue
        except CameraError as error:
            count += 1
            yield str(error)
            continue
        count += 1
        yield from _describe_device(device)
        device.close()
    if not count:
        yield "no video devices; check that a camera is plugged in and its driver works (dmesg)"


def _describe_device(device: V4l2Device) -> Iterator[str]:
    yield f"{device.path}: {device.name} (driver {device.driver})"
    for form, text in device.formats().items():
        yield f"  {form}{'' if form in FORMATS else ' (not read by the camera node)'}: {text}"
        for size in device.sizes(form):
            rates = ", ".join(f"{rate:.4g}" for rate in device.rates(form, size.high))
            yield f"    {size} px: {rates or 'unknown'} images per second"
    yield "  controls:"
    for control in device.controls().values():
        choices = f" ({', '.join(control.menu)})" if control.menu else ""
        yield (
            f"    {control.name}: {control.value}, allowed: {control.low} to {control.high}, "
            f"default: {control.default}{choices}"
        )
