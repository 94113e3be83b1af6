"""Selection of the image source for a device's name, and the list of devices that `camera --list`
prints. The name tells whether it is a V4L2 or GenICam camera, a pipe, or files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from plate_core.files import kind_of

from .genicam import PREFIX, GenicamSource
from .played import FilmSource, PipeSource
from .source import FORMATS, CameraError, Settings, Source, Warn
from .v4l2 import V4l2Source
from .v4l2_device import V4l2Device

BY_ID = Path("/dev/v4l/by-id")
"""Links to devices by manufacturer and serial number; they survive replugging."""

ALLOWED = (
    "a number or path of a video device (/dev/v4l/by-id/...), genicam:FILE.cti, a video, a "
    "picture, a folder of pictures, or a pipe"
)


def is_played(device: str) -> bool:
    """Whether a name denotes a film, a picture or a folder."""
    return kind_of(device) in ("a file", "a folder")


def make_source(settings: Settings, warn: Warn) -> Source:
    """Return the source for a device's name, not opened yet.

    Raises
    ------
    CameraError
        If the name denotes no source.
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
    there = "no such device or file" if name else "no device is given"
    raise CameraError(f"{name or 'device'}: {there}, allowed: {ALLOWED}")


def check_device(device: str) -> None:
    """Refuse a name that denotes no source, or a video device that cannot be opened.

    Raises
    ------
    CameraError
    """
    source = make_source(Settings(device), lambda _: None)
    if isinstance(source, V4l2Source):
        V4l2Device(source.path).close()


def video_devices() -> list[str]:
    """Return the paths of all video devices, by id if they have one."""
    named = {link.resolve(): link for link in sorted(BY_ID.glob("*")) if link.exists()}
    devices = sorted(Path("/dev").glob("video*"), key=lambda path: (len(path.name), path.name))
    return [str(named.get(device, device)) for device in devices]


def listing(paths: Iterable[str]) -> Iterator[str]:
    """Yield the lines of the list: formats, sizes, rates and controls of each device."""
    count = 0
    for path in paths:
        try:
            device = V4l2Device(path)
        except CameraError as error:
            if "takes no images" not in str(error):  # a camera's second device is for metadata
                count += 1
                yield str(error)
            continue
        count += 1
        yield from _described(device)
        device.close()
    if not count:
        yield "no video devices: is a camera plugged in? Its driver may be missing (dmesg)"


def _described(device: V4l2Device) -> Iterator[str]:
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
