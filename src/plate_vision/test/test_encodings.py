"""Encodings against pixels packed by hand, and files against OpenCV's own writer."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from plate_vision import ImageError
from plate_vision.camera import (
    bits_hint,
    decode,
    decode_file,
    largest_in_file,
    largest_number,
)
from plate_vision.camera.encodings import ENCODINGS, MAX_PIXELS

WIDTH, HEIGHT = 12, 8


@pytest.fixture
def bgr(rng):
    """A picture whose colours change slowly, so that a colour filter loses little."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([40 + 3 * x, 120 + 2 * y, 200 - x - y], axis=2).astype(np.uint8)


def unpack(array, encoding, **options):
    data = np.ascontiguousarray(array)
    return decode(data.tobytes(), (WIDTH, HEIGHT), encoding, data.nbytes // HEIGHT, **options)


def test_grey_and_colours(bgr):
    grey = bgr[:, :, 1]
    for encoding in ("mono8", "8UC1"):
        assert np.array_equal(unpack(grey, encoding), grey)
    for encoding in ("bgr8", "8UC3"):
        assert np.array_equal(unpack(bgr, encoding), bgr)
    opaque = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
    assert np.array_equal(unpack(bgr[:, :, ::-1], "rgb8"), bgr)
    assert np.array_equal(unpack(np.dstack([bgr, opaque]), "bgra8"), bgr)
    assert np.array_equal(unpack(np.dstack([bgr[:, :, ::-1], opaque]), "rgba8"), bgr)


def test_rows_may_be_padded(bgr):
    padded = np.zeros((HEIGHT, WIDTH + 5), np.uint8)
    padded[:, :WIDTH] = bgr[:, :, 0]
    seen = decode(padded.tobytes(), (WIDTH, HEIGHT), "mono8", WIDTH + 5)
    assert np.array_equal(seen, bgr[:, :, 0])


@pytest.mark.parametrize("more", [1, 4095, 15 * 640])
def test_the_rest_of_a_buffer_after_the_last_row_is_ignored(draw, rng, more):
    frame = draw([], [], rng)
    rest = bytes([9]) * more
    assert np.array_equal(decode(frame.tobytes() + rest, (640, 480), "mono8", 640), frame)


@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize(("order", "big"), [("<u2", False), (">u2", True)])
def test_sixteen_bits(bgr, bits, order, big):
    wide = (bgr.astype(np.uint16) << (bits - 8)) + 1
    seen = unpack(wide[:, :, 0].astype(order), "mono16", big_endian=big, bits=bits)
    assert np.array_equal(seen, bgr[:, :, 0])
    seen = unpack(wide[:, :, ::-1].astype(order), "rgb16", big_endian=big, bits=bits)
    assert np.array_equal(seen, bgr)


def test_a_hint_at_wrong_bits():
    for used in (8, 9, 10, 12, 14):
        largest = round(0.9 * 2**used)
        data = np.full((HEIGHT, WIDTH), largest, ">u2").tobytes()
        assert largest_number(data, (WIDTH, HEIGHT), "mono16", 2 * WIDTH, True) == largest
        hint = bits_hint(largest, 16)
        assert (
            f"numbers is {largest}: if they are no distances (depth image) and the camera " in hint
        )
        assert f"uses only {used} of the 16 bits, " in hint
    assert bits_hint(0, 16) == ""  # black anyway
    assert bits_hint(65535, 16) == ""
    assert "more than 12 bits" in bits_hint(65535, 12)
    assert bits_hint(largest_number(bytes(96), (12, 8), "mono8", 12), 16) == ""
    picture = cv2.imencode(".png", np.full((HEIGHT, WIDTH), 200, np.uint16))[1].tobytes()
    assert largest_in_file(picture) == 200
    opaque = np.full((HEIGHT, WIDTH, 4), (200, 200, 900, 65535), np.uint16)
    assert largest_in_file(cv2.imencode(".png", opaque)[1].tobytes()) == 900
    padded = np.pad(opaque.astype("<u2").reshape(HEIGHT, -1), ((0, 0), (0, 3)), constant_values=999)
    data = padded.tobytes() + b"\xff"  # transparency, padding of rows, and the rest of a buffer
    assert largest_number(data, (WIDTH, HEIGHT), "bgra16", 8 * WIDTH + 6) == 900
    assert largest_in_file(b"") is None


def test_values_beyond_the_bits_are_white(bgr):
    assert np.all(unpack(np.full((HEIGHT, WIDTH), 60000, "<u2"), "mono16", bits=12) == 255)


@pytest.mark.parametrize("first", ["rggb", "bggr", "gbrg", "grbg"])
def test_colour_filters(bgr, first):
    mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
    for k, colour in enumerate(first):
        mosaic[k // 2 :: 2, k % 2 :: 2] = bgr[k // 2 :: 2, k % 2 :: 2, "bgr".index(colour)]
    seen = unpack(mosaic, f"bayer_{first}8")
    assert np.abs(seen[2:-2, 2:-2].astype(int) - bgr[2:-2, 2:-2]).max() <= 2
    seen = unpack(mosaic.astype("<u2") << 8, f"bayer_{first}16")
    assert np.abs(seen[2:-2, 2:-2].astype(int) - bgr[2:-2, 2:-2]).max() <= 2


def mosaic_of(frame, first, gains=(0.75, 1.0, 0.6)):
    """Return raw Bayer data (H, W) of a grey frame. `gains` are those of blue, green and red."""
    raw = frame.astype(float)
    for k, colour in enumerate(first):
        raw[k // 2 :: 2, k % 2 :: 2] *= gains["bgr".index(colour)]
    return np.rint(raw).astype(np.uint8)


PATTERNS = ("rggb", "bggr", "gbrg", "grbg")


@pytest.mark.parametrize("first", PATTERNS)
def test_raw_colour_data_with_another_encoding_is_refused(draw, rng, first):
    """The pixels are a mosaic, but the driver declares grey pixels or another pattern."""
    frame = draw([[150.0, 200.0]], ["black"], rng)
    raw = mosaic_of(frame, first)

    def seen(pixels, encoding):
        return decode(pixels.tobytes(), (640, 480), encoding, pixels.nbytes // 480)

    with pytest.raises(ImageError, match="raw Bayer or YUV data, allowed: an encoding"):
        seen(raw, "mono8")
    with pytest.raises(ImageError, match="raw Bayer or YUV data, allowed: an encoding"):
        seen(raw.astype("<u2") << 8, "mono16")
    with pytest.raises(ImageError, match="raw Bayer or YUV data, allowed: an encoding"):
        decode_file(cv2.imencode(".png", raw)[1].tobytes(), "mono8; png compressed")
    for other in PATTERNS:
        if (other[0] == "g") == (first[0] == "g"):
            assert seen(raw, f"bayer_{other}8").shape == (480, 640, 3)
        else:
            with pytest.raises(ImageError, match=f"allowed: (bayer_.* or )?bayer_{first}( or |;)"):
                seen(raw, f"bayer_{other}8")
        seen(frame, f"bayer_{other}8")  # a camera without a colour filter
    assert np.array_equal(seen(frame, "mono8"), frame)


def test_other_patterns_of_a_grey_image_are_no_mosaic(rng):
    """Edges at even columns, a gradient, noise, and the rows of a sensor with unequal gains."""
    y, x = np.mgrid[:64, :96]
    stripes = np.where(x // 2 % 8 < 4, 200, 20)
    uneven = 100 + 1.5 * (y % 2) + 1.5 * (x % 2)
    dark = 10 + 1.5 * (y % 2)
    for pixels in (stripes, 2.5 * x, 4 * y, rng.uniform(0, 255, (64, 96)), uneven, 0 * x, dark):
        frame = np.rint(pixels).astype(np.uint8)
        assert np.array_equal(decode(frame.tobytes(), (96, 64), "mono8", 96), frame)


@pytest.mark.parametrize(("encoding", "grey", "colour"), [("yuv422", 1, 0), ("yuv422_yuy2", 0, 1)])
def test_brightness_and_colour_apart(encoding, grey, colour):
    pairs = np.empty((HEIGHT, WIDTH, 2), np.uint8)
    pairs[:, :, grey] = np.arange(30, 30 + 10 * WIDTH, 10)
    pairs[:, :, colour] = 128  # no colour
    seen = unpack(pairs, encoding)
    expected = (np.arange(30, 30 + 10 * WIDTH, 10) - 16) * 255 / 219
    assert np.abs(seen - expected[None, :, None]).max() <= 1


@pytest.mark.parametrize("encoding", ["nv12", "nv21", "yuv420"])
@pytest.mark.parametrize("padding", [0, 4])
def test_planes_have_the_colours_of_packed_pixels(rng, encoding, padding):
    """The same brightness, and the same colours in 2 x 2 pixels."""
    grey = rng.integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    blue, red = rng.integers(0, 256, (2, HEIGHT // 2, WIDTH // 2), np.uint8)
    pairs = np.dstack([np.dstack([blue, red]).reshape(HEIGHT // 2, WIDTH).repeat(2, 0), grey])

    def padded(rows, width):
        return np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=77).tobytes()

    step = WIDTH + padding
    alternating = np.dstack([red, blue] if encoding == "nv21" else [blue, red])
    colours = (
        padded(blue, step // 2) + padded(red, step // 2)
        if encoding == "yuv420"
        else padded(alternating.reshape(-1, WIDTH), step)
    )
    data = padded(grey, step) + colours
    expected = unpack(pairs, "yuv422")
    assert np.array_equal(decode(data, (WIDTH, HEIGHT), encoding, step), expected)
    if padding:
        rest = bytes(99)
        assert np.array_equal(decode(data + rest, (WIDTH, HEIGHT), encoding, step), expected)
    else:  # the mean of the bytes per row, as usb_cam publishes it
        assert np.array_equal(decode(data, (WIDTH, HEIGHT), encoding, step * 3 // 2), expected)


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("data has 96 bytes, allowed: 144", {"encoding": "nv12"}),
        (
            "size is 12 x 7 px, allowed: even",
            {"encoding": "nv21", "size_px": (12, 7), "data": bytes(126)},
        ),
        ("step is 13 bytes, allowed: even", {"encoding": "yuv420", "step": 13, "data": bytes(156)}),
        ("encoding is '32FC1', allowed: mono8", {"encoding": "32FC1"}),
        ("encoding is '', allowed", {"encoding": ""}),
        ("step is 11 bytes, allowed: at least 12", {"step": 11}),
        ("data has 95 bytes, allowed: 96", {"data": bytes(95)}),
        ("data has 0 bytes, allowed: 96", {"data": b""}),
        ("data has 4192 bytes, allowed: 96", {"data": bytes(96 + 4096)}),
        ("size is 0 x 8", {"size_px": (0, 8)}),
        ("size is 4000000000 x 4000000000", {"size_px": (4_000_000_000, 4_000_000_000)}),
        ("size is 11 x 8 px, allowed: even", {"size_px": (11, 8), "encoding": "bayer_rggb8"}),
    ],
)
def test_wrong_images_are_refused(words, change):
    good = {"data": bytes(96), "size_px": (12, 8), "encoding": "mono8", "step": 12}
    assert decode(**good).shape == (8, 12)
    with pytest.raises(ImageError, match=words):
        decode(**{**good, **change})


def test_an_image_of_one_pixel_is_decoded():
    for encoding, (kind, size) in ENCODINGS.items():
        if kind.startswith(("bayer", "yuv", "nv")):
            continue
        count = size * {"bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4}.get(kind, 1)
        assert decode(bytes(count), (1, 1), encoding, count).shape[:2] == (1, 1)


def test_files(bgr):
    for extension, limit in ((".png", 0), (".jpg", 4), (".tiff", 0), (".webp", 40)):
        content = cv2.imencode(extension, bgr)[1].tobytes()
        for form in (extension[1:], f"bgr8; {extension[1:]} compressed bgr8"):
            assert np.abs(decode_file(content, form).astype(int) - bgr).max() <= limit
        grey = cv2.imencode(extension, bgr[:, :, 1])[1].tobytes()
        shape = (HEIGHT, WIDTH, 3) if extension == ".webp" else (HEIGHT, WIDTH)
        assert decode_file(grey, extension[1:]).shape == shape
    wide = cv2.imencode(".png", bgr[:, :, 1].astype(np.uint16) << 4)[1].tobytes()
    assert np.array_equal(decode_file(wide, "mono16; png compressed", bits=12), bgr[:, :, 1])
    filtered = cv2.imencode(".png", np.full((HEIGHT, WIDTH), 7, np.uint8))[1].tobytes()
    seen = decode_file(filtered, "bayer_rggb8; png compressed bayer_rggb8")
    assert seen.shape == (HEIGHT, WIDTH, 3)
    assert np.all(seen == 7)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("form", ["jpeg", "png"])
def test_files_are_never_turned(bgr, form, orientation):
    """As image_transport has it: pixels are where the sensor has them."""
    whole = cv2.imencode(f".{form}", bgr)[1].tobytes()
    tags = b"II" + struct.pack("<HIHHHIHHI", 42, 8, 1, 274, 3, 1, orientation, 0, 0)
    if form == "jpeg":
        body = b"Exif\0\0" + tags
        marked = whole[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + whole[2:]
    else:
        check = zlib.crc32(b"eXIf" + tags)
        chunk = struct.pack(">I", len(tags)) + b"eXIf" + tags + struct.pack(">I", check)
        marked = whole[:33] + chunk + whole[33:]
    if orientation > 4 and form == "jpeg":  # otherwise these tests would prove nothing
        assert cv2.imdecode(np.frombuffer(marked, np.uint8), 1).shape[:2] == (WIDTH, HEIGHT)
    assert np.array_equal(decode_file(marked, form), decode_file(whole, form))


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp"])
def test_files_that_break_off_are_refused(rng, extension):
    """At any byte: OpenCV would fill the missing part of a JPEG with grey."""
    picture = rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    content = cv2.imencode(extension, picture)[1].tobytes()
    for length in range(len(content) - 1):
        with pytest.raises(ImageError, match="allowed: "):
            decode_file(content[:length], extension[1:])


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp"])
@pytest.mark.parametrize("rest", [bytes(5000), bytes(range(255, -1, -1)) * 20])
def test_the_rest_of_a_buffer_after_a_file_is_ignored(rng, extension, rest):
    picture = rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    content = cv2.imencode(extension, picture)[1].tobytes()
    assert np.array_equal(decode_file(content + rest, "jpeg"), decode_file(content, "jpeg"))


def test_a_preview_does_not_hide_that_a_file_breaks_off(rng):
    content = cv2.imencode(".jpg", rng.integers(0, 255, (64, 64), dtype=np.uint8))[1].tobytes()
    body = b"Exif\0\0II" + content
    preview = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    assert decode_file(content[:2] + preview + content[2:], "jpeg").shape == (64, 64)
    with pytest.raises(ImageError, match="is incomplete"):
        decode_file(content[:2] + preview + content[2:-20], "jpeg")


def test_a_tiff_file_that_breaks_off_is_refused_or_has_all_pixels(rng):
    """The last bytes of the file are no pixels."""
    picture = rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    content = cv2.imencode(".tiff", picture)[1].tobytes()
    refused = 0
    for length in range(len(content)):
        try:
            assert np.array_equal(decode_file(content[:length], "tiff"), picture)
        except ImageError:
            refused += 1
    assert refused > 100


def test_invalid_image_files_are_refused(rng):
    for content in (b"", b"\xff\xd8", b"\xff" * 40, rng.bytes(1000), b"\xff\xd8\xff\xd9"):
        with pytest.raises(ImageError, match="allowed: "):
            decode_file(content, "jpeg")
    with pytest.raises(ImageError, match="compressedDepth"):
        decode_file(b"", "16UC1; compressedDepth png")


@pytest.mark.parametrize("encoding", ["mono16", "bgr16", "bayer_rggb16", "16UC1"])
@pytest.mark.parametrize("shift", [0, 4])
def test_a_wrong_byte_order_is_refused(draw, rng, encoding, shift):
    """Some drivers always set is_bigendian to 0, or to 1."""
    grey = draw(rng.uniform([60, 130], [580, 350], (20, 2)), ["black"] * 20, rng)
    wide = (grey.astype(np.uint16) << 8) + rng.integers(0, 256, grey.shape, np.uint16) >> shift
    if encoding == "bayer_rggb16":
        wide[::2, ::2] //= 2
    wide = np.dstack([wide] * 3) if encoding == "bgr16" else wide
    step = wide.strides[0]
    for order, big in (("<u2", False), (">u2", True)):
        data = wide.astype(order).tobytes()
        assert decode(data, (640, 480), encoding, step, big, 16 - shift).shape[:2] == (480, 640)
        right = f"is_bigendian is {1 - big:d}, but .*allowed: is_bigendian {big:d}"
        with pytest.raises(ImageError, match=right):
            decode(data, (640, 480), encoding, step, not big, 16 - shift)
    for other in (0 * wide, rng.integers(0, 2**16, wide.shape, np.uint16)):  # black, and noise
        for big in (False, True):
            decode(other.tobytes(), (640, 480), encoding, step, big)


def test_pictures_of_other_numbers_are_refused(rng):
    picture = rng.uniform(0, 1, (HEIGHT, WIDTH)).astype(np.float32)
    content = cv2.imencode(".tiff", picture)[1].tobytes()
    with pytest.raises(ImageError, match="values are float32, allowed: 8 or 16 bits"):
        decode_file(content, "tiff")


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"GIF89a" + bytes(20), "GIF"),
        (b"\0\0\0 ftypavif" + bytes(20), "AVIF"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000"),
        (b"P5 12 8 255 " + bytes(96), "PNM"),
        (b"\0\0\0\1\x67\x42", "a video stream"),
        (b"no picture", "unknown"),
    ],
)
def test_other_formats_are_named(content, name):
    words = f"is {name}.*, and format of the message is 'h264', allowed: JPEG, PNG, TIFF, WebP"
    with pytest.raises(ImageError, match=words):
        decode_file(content, "h264")


def test_files_that_claim_to_be_huge_are_not_unpacked(bgr):
    content = bytearray(cv2.imencode(".png", bgr)[1].tobytes())
    content[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(ImageError, match=f"60000 x 60000 px.*{MAX_PIXELS:,}"):
        decode_file(bytes(content), "png")
    content = cv2.imencode(".png", bgr)[1].tobytes()
    with pytest.raises(ImageError, match="size is 12 x 8 px, allowed: 640 x 480 px"):
        decode_file(content, "png", size_px=(640, 480))


def test_damaged_files_never_raise_anything_else(rng, bgr):
    for extension in (".png", ".jpg"):
        content = cv2.imencode(extension, bgr)[1].tobytes()
        for _ in range(40):
            damaged = bytearray(content)
            for place in rng.integers(0, len(content), 3):
                damaged[place] = rng.integers(256)
            try:
                seen = decode_file(bytes(damaged), extension[1:], size_px=(WIDTH, HEIGHT))
                assert seen.shape == (HEIGHT, WIDTH, 3)
            except ImageError:
                pass
