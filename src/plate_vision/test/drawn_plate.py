"""Pictures of a plate on a table through a pinhole camera with a lens, drawn by filled polygons on
a finer grid: no code is shared with the detector or the simulator."""

import dataclasses

import cv2
import numpy as np

FINE = 4
"""Sub-pixels along each side of a pixel."""

BITS = 6
"""Binary digits after the point of a polygon's corners."""


@dataclasses.dataclass(frozen=True)
class View:
    """A camera above the plate: it looks at `at` [m], from `distance` [m], tilted about x and y and
    rolled [degrees]."""

    focal: float = 900.0
    distance: float = 0.91
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    roll: float = 0.0
    at: tuple = (0.0, 0.0)
    lens: tuple = (0.0, 0.0, 0.0)  # k1, k2, k3
    size: tuple = (640, 480)

    @property
    def centre(self):
        """The middle of the image [px]."""
        return (np.array(self.size) - 1) / 2

    def see(self, point):
        """Image points (n, 2) [px] of points (n, 2) [m] of the plate."""
        a, b, c = np.radians([self.tilt_x, self.tilt_y, self.roll])
        about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        flat = np.column_stack([np.asarray(point) - self.at, np.zeros(len(point))])
        x, y, z = (flat @ (about_z @ about_y @ about_x).T).T
        u, v = x / (self.distance - z), -y / (self.distance - z)
        r = u * u + v * v
        k1, k2, k3 = self.lens
        bent = 1 + k1 * r + k2 * r**2 + k3 * r**3
        return self.focal * np.column_stack([u, v]) * bent[:, None] + self.centre


def rectangle(length, width, centre=(0.0, 0.0), turn=0.0, points=40):
    """Points along the edges of a rectangle [m], counter-clockwise from (-x, -y)."""
    half = np.array([length, width]) / 2
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    t = np.arange(points)[:, None] / points
    edge = [a + t * (b - a) for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True)]
    c, s = np.cos(turn), np.sin(turn)
    return np.concatenate(edge) @ np.array([[c, s], [-s, c]]) + centre


def disc(x, y, radius):
    """Points around a disc [m]."""
    t = 2 * np.pi * np.arange(48) / 48
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


def draw(view, shapes, room, noise=2.0, seed=0, slope=0.0):
    """Return an image (H, W) uint8, or (H, W, 3) if greys are triples, of polygons (points [m],
    grey) one over another on a room of this grey; `slope` is the change of light across it."""
    width, height = view.size
    room = np.atleast_1d(np.asarray(room, float))
    fine = np.empty((height * FINE, width * FINE, len(room)), np.float32)
    fine[:] = room
    for point, grey in shapes:
        corner = (view.see(point) + 0.5) * FINE - 0.5
        ring = np.rint(corner * 2**BITS).astype(np.int32)
        cv2.fillPoly(fine, [ring], np.broadcast_to(grey, room.shape).tolist(), shift=BITS)
    image = cv2.resize(fine, view.size, interpolation=cv2.INTER_AREA).reshape(height, width, -1)
    light = 1 + slope * np.linspace(-1, 1, width)[None, :, None]
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(image, (0, 0), 0.7).reshape(image.shape) * light
    image = image + noise * rng.standard_normal(image.shape)
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return image[..., 0] if len(room) == 1 else image


def board_picture(print_px, board, matrix, bend, turn_deg, place):
    """Return an image (480, 640) uint8 of a board's print, rotated about the camera's axes
    [degrees], its middle at a place [m] before a camera (3, 3) with distortion (5,)."""
    squares = np.array([board.columns, board.rows])
    ends = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (squares + 1) - (squares + 1) / 2
    turn = cv2.Rodrigues(np.radians(np.array(turn_deg, float)))[0]
    corners = np.column_stack([board.square_m * ends, np.zeros(4)]) @ turn.T + place
    straight = corners @ matrix.T
    straight = (straight[:, :2] / straight[:, 2:]).astype(np.float32)
    high, wide = print_px.shape
    frame = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float32) - 0.5
    warp = cv2.getPerspectiveTransform(frame, straight)
    pixel = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=2).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixel.astype(np.float32), matrix, bend, P=matrix)
    source = cv2.perspectiveTransform(ideal, np.linalg.inv(warp)).reshape(480, 640, 2)
    seen = cv2.remap(print_px, source.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=150)
    return cv2.GaussianBlur(seen, (0, 0), 0.6)
