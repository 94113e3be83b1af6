"""Conversion of image encodings to grey levels (H, W) or blue, green, red (H, W, 3), uint8.

The input is the data of sensor_msgs/Image or CompressedImage. Sizes are checked before pixels are
unpacked.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..errors import ImageError, check_image, check_size
from .headers import PNG, Header, is_whole, name_of_format, read_header, reset_orientation

BAYER = {
    # OpenCV names a Bayer pattern by the colours in its second row and second column.
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
"""Bayer patterns, named by their first two rows and columns, and OpenCV's demosaicing codes."""

PLANAR = {
    "nv12": cv2.COLOR_YUV2BGR_NV12,
    "nv21": cv2.COLOR_YUV2BGR_NV21,
    "yuv420": cv2.COLOR_YUV2BGR_I420,
}
"""Kinds of pixels whose colour follows the brightness, with one colour for 2 x 2 pixels. In `nv12`
and `nv21`, the two colour values alternate. In `yuv420`, each has a plane (V4L2's YU12)."""

CODES = {
    "mono": None,
    "bgr": None,
    "rgb": cv2.COLOR_RGB2BGR,
    "bgra": cv2.COLOR_BGRA2BGR,
    "rgba": cv2.COLOR_RGBA2BGR,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    **BAYER,
    **PLANAR,
}
"""OpenCV's conversion codes from a kind of pixels to blue, green, red. The code is None if no
conversion is needed."""

CHANNELS = {"bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "yuv422": 2, "yuv422_yuy2": 2}
"""Number of channels for each kind of pixels with more than one channel."""

ENCODINGS = {
    **{f"{kind}8": (kind, 1) for kind in CODES if not kind.startswith(("yuv", "nv"))},
    **{f"{kind}16": (kind, 2) for kind in CODES if not kind.startswith(("yuv", "nv"))},
    **{kind: (kind, 1) for kind in PLANAR},
    "yuv422": ("yuv422", 1),
    "uyvy": ("yuv422", 1),
    "yuv422_yuy2": ("yuv422_yuy2", 1),
    "yuyv": ("yuv422_yuy2", 1),
    "8UC1": ("mono", 1),
    "8UC3": ("bgr", 1),
    "16UC1": ("mono", 2),
}
"""Kind of pixels and bytes per value for each encoding of sensor_msgs/Image."""

PADDING, PADDING_ROWS = 4096, 16
"""Limits of the padding after the last row [bytes], [rows]. An image is refused if its padding
reaches the larger limit. Drivers of video devices publish the whole buffer, which ends at a
multiple of 4096 bytes or of 16 rows."""

MAX_PIXELS = 50_000_000
"""Maximum size of an unpacked image [pixels], which is 0.15 GB in colour. The limit is needed
because a small file can declare a much larger image."""

ORDER_ROWS = 16
"""Approximate number of rows in which the byte order of 16-bit numbers is checked."""

NEIGHBOUR = 12
"""Distance of the compared numbers in a row. It is a multiple of 2, 3 and 4, so that both belong to
the same channel, or to the same colour of a Bayer pattern."""

NOISY, SMOOTH = 0.1, 0.03
"""Differences of numbers, relative to their range. In noise, the difference is 0.32. `NOISY` is the
minimum of a wrong byte order, and `SMOOTH` the maximum of the right one."""

PNG_DEPTH = 24
"""Position of the byte that contains the bit depth in a PNG file [bytes]."""

BLOCKS, MIN_SIDE = 64, 64
"""BLOCKS: approximate number of 2 x 2 blocks along each side of an image in which a mosaic is
searched. MIN_SIDE: minimum width and height of such an image [px]. In a smaller image, a gradient
of the light looks like a mosaic."""

MOSAIC, MOSAIC_GREY = 0.05, 2.0
"""Minimum range of the means of the four pixels of 2 x 2 blocks in a mosaic: relative to the mean
of all pixels [-], and absolute [grey levels]. In grey images, the relative range is below 0.02, but
in dark images, sensors with unequal rows exceed it. In raw Bayer data, it is 0.2 to 0.6."""

COMPRESSED = ("JPEG", "PNG", "TIFF", "WebP")
"""Formats of sensor_msgs/CompressedImage that are read."""


def decode(
    data: bytes | bytearray | memoryview,
    size_px: tuple[int, int],
    encoding: str,
    step: int,
    big_endian: bool = False,
    bits: int = 16,
) -> np.ndarray:
    """Return the pixels of a sensor_msgs/Image.

    Parameters
    ----------
    data : bytes-like
        Rows of pixels, first to last.
    size_px : (int, int)
        Width and height [px].
    encoding : str
        A key of `ENCODINGS`.
    step : int
        Number of bytes from the start of one row to the start of the next. With an encoding of
        `PLANAR`, this refers to the brightness.
    big_endian : bool
        Byte order of 16-bit numbers.
    bits : int
        Number of used bits of 16-bit numbers. For example, `bits` is 12 for a camera with the
        maximum value 4095.

    Returns
    -------
    (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red. The array shares the memory of `data` if no conversion is
        needed.

    Raises
    ------
    ImageError
        If the encoding is unknown, or the size, the step and the number of bytes are inconsistent.
    """
    if encoding not in ENCODINGS:
        raise ImageError(f"image: encoding is {encoding!r}, allowed: {', '.join(ENCODINGS)}")
    kind, size = ENCODINGS[encoding]
    width, height = size_px
    check_pixel_count(width, height)
    channels = CHANNELS.get(kind, 1)
    row = width * channels * size
    if step < row:
        raise ImageError(f"image: step is {step} bytes, allowed: at least {row}")
    if kind in PLANAR and 2 * len(data) == 3 * width * height:
        step = width  # no padding; usb_cam publishes the mean number of bytes per row as step
    size_bytes = step * height * 3 // 2 if kind in PLANAR else step * height
    if not size_bytes <= len(data) < size_bytes + max(PADDING, PADDING_ROWS * step):
        raise ImageError(f"image: data has {len(data)} bytes, allowed: {size_bytes}")
    if kind.startswith(("bayer", "yuv", "nv")) and (width % 2 or height % 2):
        raise ImageError(
            f"image: size is {width} x {height} px, allowed: even numbers with encoding {encoding}"
        )
    if kind == "yuv420" and step % 2:
        raise ImageError(f"image: step is {step} bytes, allowed: even numbers with {encoding}")
    if kind in PLANAR:
        return to_colour(_planes(data, size_px, kind, step), kind)
    pixels = _rows(data, size_px, encoding, step)
    if size == 2:
        wide = _wide(pixels, big_endian)
        check_byte_order(wide, big_endian)
        pixels = to_8_bits(wide, bits)
    if channels == 1:
        check_mosaic(pixels, kind)
    return to_colour(pixels if channels == 1 else pixels.reshape(height, width, channels), kind)


def decode_file(
    data: bytes | bytearray | memoryview,
    form: str,
    bits: int = 16,
    size_px: tuple[int, int] | None = None,
) -> np.ndarray:
    """Return the pixels of a sensor_msgs/CompressedImage, as image_transport publishes it.

    Parameters
    ----------
    data : bytes-like
        A file in a format of `COMPRESSED`.
    form : str
        The message's format: `jpeg`, `png`, or image_transport's `bgr8; jpeg compressed bgr8`.
    bits : int
        Number of used bits of 16-bit numbers, as in `decode`.
    size_px : (int, int), optional
        Expected width and height. A file of another size is refused before it is unpacked.

    Returns
    -------
    (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.

    Raises
    ------
    ImageError
        If the file has another format, is damaged or truncated, or has another size.
    """
    if "compressedDepth" in form:
        raise ImageError(f"image: format is {form!r}, allowed: {', '.join(COMPRESSED)}")
    content = bytes(data)
    header = read_header(content)
    if header is None or header.kind not in COMPRESSED:
        name = name_of_format(content) or "unknown"
        raise ImageError(
            f"image: format of the data ({len(content)} bytes) is {name}, and format of the "
            f"message is {form[:50]!r}, allowed: {', '.join(COMPRESSED)}"
        )
    check_pixel_count(header.width, header.height)
    if size_px is not None:
        check_size("image: size is", (header.width, header.height), size_px)
    if not is_whole(content, header):
        raise ImageError(
            f"image: file of {len(content)} bytes is incomplete, allowed: a complete file"
        )
    pixels = decode_picture(content, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH, header)
    if pixels is None:
        raise ImageError(
            f"image: {header.kind} file of {len(content)} bytes is damaged or truncated, or this "
            f"OpenCV cannot decode it, allowed: an intact file ({', '.join(COMPRESSED)})"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"image: values are {pixels.dtype}, allowed: 8 or 16 bits")
    if pixels.dtype == np.uint16:
        pixels = to_8_bits(pixels, bits)
    kind = ENCODINGS.get(form.split(";")[0].strip(), ("", 1))[0]
    if pixels.ndim == 3:
        return pixels
    kind = kind if kind in BAYER else "mono"
    check_mosaic(pixels, kind)
    return to_colour(pixels, kind)


def check_byte_order(wide: np.ndarray, big_endian: bool) -> None:
    """Refuse 16-bit numbers (H, W) whose byte order is not the declared one.

    With the wrong byte order, neighbouring pixels differ as much as in noise. With the right one,
    they differ little. Both differences are divided by the range of the numbers, because the
    factor of the numbers does not matter.

    Raises
    ------
    ImageError
        If the image is noise in the declared byte order, and smooth in the other one.
    """
    sample = wide[:: max(1, len(wide) // ORDER_ROWS)]
    if _roughness(sample) > NOISY and _roughness(sample.byteswap()) < SMOOTH:
        declared, right = ("1", "0") if big_endian else ("0", "1")
        raise ImageError(
            f"image: is_bigendian is {declared}, but the numbers have the other byte order, "
            f"allowed: is_bigendian {right} for this image; set it in the camera's driver"
        )


def check_mosaic(pixels: np.ndarray, kind: str) -> None:
    """Refuse a mosaic (H, W) uint8 that is not of the declared kind, a key of `CODES`.

    In a grey image, pixels in even and odd rows and columns have the same mean. In raw Bayer data,
    the two green pixels of each 2 x 2 block have the same mean, and the others have another mean.

    Raises
    ------
    ImageError
        If a grey image is a mosaic, or if the green pixels of a Bayer pattern are at other places.
    """
    height, width = (side // 2 for side in pixels.shape)
    if min(height, width) < MIN_SIDE // 2:
        return
    blocks = pixels[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    step = max(1, height // BLOCKS), max(1, width // BLOCKS)
    mean = blocks[:: step[0], :, :: step[1]].mean(axis=(0, 2))
    limit = max(MOSAIC * float(mean.mean()), MOSAIC_GREY)
    spread = float(np.ptp(mean))
    if spread <= limit:
        return
    if kind == "mono":
        raise ImageError(
            f"image: pixels in even and odd rows or columns differ by {spread:.0f} grey levels, as "
            "in raw Bayer or YUV data, allowed: an encoding that describes the data, such as "
            "bayer_rggb8; set it, or mono8 with conversion, in the camera's driver"
        )
    gaps = abs(mean[0, 0] - mean[1, 1]), abs(mean[0, 1] - mean[1, 0])
    on_diagonal = kind[len("bayer_")] == "g"
    green, other = gaps if on_diagonal else gaps[::-1]
    if green > limit and other < 0.25 * green:
        allowed = "bayer_rggb or bayer_bggr" if on_diagonal else "bayer_grbg or bayer_gbrg"
        raise ImageError(
            f"image: encoding is {kind}, but the green pixels have other places, allowed: {allowed}"
            "; set it in the camera's driver"
        )


def _roughness(wide: np.ndarray) -> float:
    """Return the median difference of neighbours in rows, divided by the range of 90 % of the
    numbers. The result is 0 for a constant image."""
    low, high = np.percentile(wide, (5, 95))
    if wide.shape[1] < NEIGHBOUR + 1 or high <= low:
        return 0.0
    numbers = wide.astype(np.int32)
    return float(np.median(np.abs(numbers[:, NEIGHBOUR:] - numbers[:, :-NEIGHBOUR])) / (high - low))


def largest_number(
    data: bytes | bytearray | memoryview,
    size_px: tuple[int, int],
    encoding: str,
    step: int,
    big_endian: bool = False,
) -> int | None:
    """Return the largest 16-bit number of a sensor_msgs/Image that `decode` has accepted, without
    padding and transparency. The arguments are as in `decode`. Return None for encodings with 8
    bits."""
    kind, size = ENCODINGS[encoding]
    if size != 2:
        return None
    wide = _wide(_rows(data, size_px, encoding, step), big_endian)
    return int(wide.reshape(len(wide), -1, CHANNELS.get(kind, 1))[:, :, :3].max(initial=0))


def _rows(
    data: bytes | bytearray | memoryview, size_px: tuple[int, int], encoding: str, step: int
) -> np.ndarray:
    """Return the bytes of an image's rows (H, bytes) without padding. The arguments are as in
    `decode`."""
    kind, size = ENCODINGS[encoding]
    width, height = size_px
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)
    return rows[:, : width * CHANNELS.get(kind, 1) * size]


def _planes(
    data: bytes | bytearray | memoryview, size_px: tuple[int, int], kind: str, step: int
) -> np.ndarray:
    """Return brightness and colour (3 H / 2, W) of an image without padding. `kind` is a key of
    `PLANAR`. The other arguments are as in `decode`."""
    width, height = size_px
    values = np.frombuffer(data, np.uint8, step * height * 3 // 2)
    parts = 2 if kind == "yuv420" else 1  # planes of colour
    colour = values[step * height :].reshape(-1, step // parts)[:, : width // parts]
    return np.vstack(
        [values[: step * height].reshape(-1, step)[:, :width], colour.reshape(-1, width)]
    )


def _wide(rows: np.ndarray, big_endian: bool) -> np.ndarray:
    """Return the 16-bit numbers (H, n) of rows (H, 2 n) uint8."""
    return np.ascontiguousarray(rows).view(">u2" if big_endian else "<u2")


def largest_in_file(content: bytes | bytearray | memoryview) -> int | None:
    """Return the largest number in a 16-bit PNG file, without transparency. Return None for all
    other files, and for a damaged file."""
    if not is_wide_file(content):
        return None
    pixels = decode_picture(bytes(content), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    return None if pixels is None else int(pixels.max(initial=0))


def is_wide_file(content: bytes | bytearray | memoryview) -> bool:
    """Whether a picture's file has 16 bits per number. Only PNG files can have 16 bits."""
    return bytes(content[: len(PNG)]) == PNG and len(content) > PNG_DEPTH and content[PNG_DEPTH] > 8


def bits_hint(largest: int | None, bits: int) -> str:
    """Return a hint for an image that is too dark or too bright. `largest` is the largest 16-bit
    number of the image. The hint suggests another value of `bits`. The result is empty if `bits` is
    not the reason, or if the image is black or has 8 bits (None)."""
    if not largest:
        return ""
    used = max(largest.bit_length(), 8)
    if used >= bits:
        return f"; if the camera uses more than {bits} bits, increase bits" if bits < 16 else ""
    return (
        f"; the largest of the 16-bit numbers is {largest}: if they are no distances (depth image) "
        f"and the camera uses only {used} of the {bits} bits, set the parameter bits to {used}"
    )


def decode_picture(content: bytes, flags: int, header: Header | None = None) -> np.ndarray | None:
    """Return the pixels of a picture file. Return None if the file is damaged or not a picture.

    `flags` are OpenCV's flags for the number of channels and bits. The picture is never rotated.

    `header` is the header of the file, if it has been read already.

    Raises
    ------
    ImageError
        If the file declares no pixels or too many pixels. The number of pixels is checked before
        unpacking.
    """
    header = header or read_header(content)
    if header is None:
        return None
    check_pixel_count(header.width, header.height)
    data = np.frombuffer(reset_orientation(content, header), np.uint8)
    try:
        pixels = cv2.imdecode(data, flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    return pixels


def grey_levels(image: np.ndarray) -> np.ndarray:
    """Return the grey levels (H, W) of an image (H, W) or (H, W, 3) uint8. For a colour image, the
    result is the green channel.

    Raises
    ------
    ImageError
        If the image is not uint8, or has another shape.
    """
    image = np.asarray(image)
    check_image(image)
    grey = image if image.ndim == 2 else image[:, :, 1]
    # without this, each kernel would make its own contiguous copy
    return np.ascontiguousarray(grey)


def check_pixel_count(width: int, height: int, what: str = "image:") -> None:
    """Refuse images without pixels or with too many pixels. The error message begins with
    `what`."""
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImageError(
            f"{what} size is {width} x {height} px, allowed: at least 1 x 1, "
            f"at most {MAX_PIXELS:,} pixels"
        )


def to_8_bits(wide: np.ndarray, bits: int) -> np.ndarray:
    """Return the upper eight of the used `bits` of 16-bit numbers."""
    return np.minimum(wide >> (bits - 8), 255).astype(np.uint8)


def to_colour(pixels: np.ndarray, kind: str) -> np.ndarray:
    """Return blue, green, red (H, W, 3) or grey levels (H, W) of pixels. `kind` is a key of
    `CODES`."""
    code = CODES[kind]
    if code is None:
        return pixels
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), code))
