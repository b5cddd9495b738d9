"""The extended pinhole: eleven parameters <-> camera + pose <-> 3x4 matrix. The only file that uses the thesis' axes.

Image points are (U, V): U points down, V to the right, so (U, V) = (y, x) of our pixels. The camera's axes are x' down,
y' right, and it looks along -z':

    X' = R (X - F),  R = Rz(c) Ry(b) Rx(a)
    U = U0 + f x'/(-z'),   V = V0 + f p (sin(beta) x' + cos(beta) y')/(-z')

Source: "Industrial Vision" (1997), section 2.2, with the signs and orders of docs/thesis/errata.md.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Lens
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_numbers

# rows of our camera frame (x right, y down, z forward) in the thesis' (x' down, y' right, z' back)
OURS_FROM_THESIS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
PIXEL_FROM_UV = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class ExtendedPinhole:
    """The eleven parameters in the thesis' names: X, Y, Z mm; a, b, c, skew rad; focal, U0, V0 px; aspect a ratio.

    (X, Y, Z) is the focal centre F. focal is in U pixels, aspect is V pixels per U pixel, skew is beta.
    """

    X: float
    Y: float
    Z: float
    a: float
    b: float
    c: float
    aspect: float
    focal: float
    skew: float
    U0: float
    V0: float

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name, value in zip(NAMES, astuple(self), strict=True):
            if not np.isfinite(value):
                raise BadValue(name, value, "a finite number")
        if self.focal <= 0 or self.aspect <= 0 or abs(self.skew) >= np.pi / 2:
            raise BadValue(
                "(focal, aspect, skew)",
                (self.focal, self.aspect, self.skew),
                "focal and aspect above 0 and skew below 90 deg",
            )

    @classmethod
    def from_vector(cls, values: Floats) -> ExtendedPinhole:
        """Return the parameters of an array (11,) in the order of `NAMES`, angles in rad."""
        return cls(*(float(x) for x in frozen(values, "extended pinhole parameters", (len(NAMES),))))

    @classmethod
    def from_camera(cls, camera: Camera, camera_from_world: Rigid) -> ExtendedPinhole:
        """Return the eleven parameters of a camera and its pose; the lens is not among them."""
        angles = angles_of(OURS_FROM_THESIS.T @ camera_from_world.rotation)
        return cls.from_vector(np.concatenate([camera_from_world.origin, angles, internals_of(camera.K)]))

    @classmethod
    def from_matrix(cls, C: Floats) -> ExtendedPinhole:
        """Return the parameters of a 3x4 matrix with (U, V, 1) ~ C (X, Y, Z, 1), of any scale and either sign of det M.

        Branch-free: Gram-Schmidt on the rows of M replaces the case distinctions of EQ 2.109-2.160. Raises
        `DegenerateGeometry` when M has no inverse: the focal centre is then at infinity.
        """
        C = frozen(C, "projection matrix C", (3, 4))
        M = C[:, :3]
        _refuse_singular(M)
        N = -np.sign(np.linalg.det(M)) * M / np.linalg.norm(M[2])
        F = -np.linalg.solve(M, C[:, 3])
        U0, V0 = N[0] @ N[2], N[1] @ N[2]
        q1, q2 = N[0] - U0 * N[2], N[1] - V0 * N[2]
        focal = np.linalg.norm(q1)
        r0 = q1 / focal
        w = q2 - (q2 @ r0) * r0
        R = np.stack([r0, w / np.linalg.norm(w), -N[2]])
        return cls.from_vector(
            [
                *F,
                *angles_of(R),
                np.linalg.norm(q2) / focal,
                focal,
                np.arctan2(q2 @ r0, np.linalg.norm(w)),
                U0,
                V0,
            ]
        )

    @property
    def vector(self) -> Array:
        """Return the parameters (11,) in the order of `NAMES`."""
        return np.array(astuple(self))

    @property
    def rotation(self) -> Array:
        """Return R = Rz(c) Ry(b) Rx(a): world axes to the thesis' camera axes."""
        return rotation_of(self.a, self.b, self.c)

    @property
    def camera_from_world(self) -> Rigid:
        """Return the pose in our camera frame (x right, y down, z forward)."""
        R = OURS_FROM_THESIS @ self.rotation
        return Rigid(R, -R @ np.array([self.X, self.Y, self.Z]))

    @property
    def K(self) -> Array:
        """Return our camera matrix: fx = f p cos(beta), K01 = f p sin(beta), fy = f, (cx, cy) = (V0, U0)."""
        scale = self.focal * self.aspect
        return np.array(
            [
                [scale * np.cos(self.skew), scale * np.sin(self.skew), self.V0],
                [0.0, self.focal, self.U0],
                [0.0, 0.0, 1.0],
            ]
        )

    def camera(self, size: tuple[int, int], lens: Lens | None = None) -> Camera:
        """Return the camera of `size` (width, height) px with these internals."""
        return Camera(size, self.K) if lens is None else Camera(size, self.K, lens)

    @property
    def unnormalized_matrix(self) -> Array:
        """Return the thesis' K = U S W P Rz Ry Rx D (EQ 2.75, order corrected), 3x4; its row 2 is (depth)/focal."""
        P = self.K @ np.column_stack([self.camera_from_world.rotation, self.camera_from_world.translation])
        return np.asarray(PIXEL_FROM_UV @ P / self.focal)

    @property
    def matrix(self) -> Array:
        """Return C = K/K23 (3x4), the DLT's matrix with C23 = 1; `DegenerateGeometry` if the origin has depth 0."""
        K = self.unnormalized_matrix
        if abs(K[2, 3]) <= 1e-12 * np.abs(K[2]).max():
            raise DegenerateGeometry(
                f"C23 = 1 is impossible: the world origin lies in the camera's focal plane (K23 = {K[2, 3]:.3g}); "
                "use unnormalized_matrix, or shift the world's origin"
            )
        return np.asarray(K / K[2, 3])

    def __repr__(self) -> str:
        told = (f"{name}={value:.6g} {UNITS.get(name, '')}" for name, value in zip(NAMES, astuple(self), strict=True))
        return f"ExtendedPinhole({', '.join(one.rstrip() for one in told)})"


NAMES: tuple[str, ...] = tuple(f.name for f in fields(ExtendedPinhole))
MATRIX_ENTRIES = ("fx", "fy", "cx", "cy")  # of the camera matrix, px
EXTERNALS, INTERNALS = NAMES[:6], NAMES[6:]
UNITS = {"X": "mm", "Y": "mm", "Z": "mm", "a": "rad", "b": "rad", "c": "rad", "focal": "px", "skew": "rad"}
UNITS |= {"U0": "px", "V0": "px"}  # aspect has none


def internals_of(K: Array) -> Array:
    """Return (aspect, focal, skew, U0, V0) of a camera matrix, px and rad."""
    return np.array(
        [np.hypot(K[0, 0], K[0, 1]) / K[1, 1], K[1, 1], np.arctan2(K[0, 1], K[0, 0]), K[1, 2], K[0, 2]],
    )


def internals_by_name(camera: Camera) -> dict[str, float]:
    """Return the internals of a camera by their names, aspect, focal, skew, U0, V0; px and rad."""
    return dict(zip(INTERNALS, internals_of(camera.K).tolist(), strict=True))


def matrix_entry(camera: Camera, name: str) -> tuple[float, Array] | None:
    """Return an entry of the camera matrix, px, and its derivative (5,) by aspect, focal, skew, U0, V0.

    name: fx, fy, cx or cy; None for another, such as one of the thesis' own names.
    """
    if name not in MATRIX_ENTRIES:
        return None
    aspect, focal, skew, U0, V0 = internals_of(camera.K).tolist()
    sin, cos = np.sin(skew), np.cos(skew)
    value, by = {
        "fx": (focal * aspect * cos, [focal * cos, aspect * cos, -focal * aspect * sin, 0, 0]),
        "fy": (focal, [0, 1, 0, 0, 0]),
        "cx": (V0, [0, 0, 0, 0, 1]),
        "cy": (U0, [0, 0, 0, 1, 0]),
    }[name]
    return float(value), np.array(by, dtype=np.float64)


def camera_of(internals: Array, size: tuple[int, int], lens: Lens | None = None) -> Camera:
    """Return the camera of `size` (width, height) px with these internals (5,), the inverse of `internals_of`."""
    return ExtendedPinhole(0, 0, 0, 0, 0, 0, *(float(x) for x in internals)).camera(size, lens)


def rotation_of(a: float, b: float, c: float) -> Array:
    """Return Rz(c) Ry(b) Rx(a) of EQ 2.68-2.70 (Ry's signs corrected), angles in rad."""
    (sa, sb, sc), (ca, cb, cc) = np.sin([a, b, c]), np.cos([a, b, c])
    Rx = np.array([[1, 0, 0], [0, ca, sa], [0, -sa, ca]])
    Ry = np.array([[cb, 0, -sb], [0, 1, 0], [sb, 0, cb]])
    Rz = np.array([[cc, sc, 0], [-sc, cc, 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)


def angles_of(R: Array) -> Array:
    """Return (a, b, c) (..., 3) in rad of rotations (..., 3, 3), b in [-pi/2, pi/2].

    At b = +-90 deg only a -+ c is defined and c is taken as 0.
    """
    cos_b = np.hypot(R[..., 0, 0], R[..., 1, 0])
    free = cos_b >= 1e-9
    a = np.where(free, np.arctan2(-R[..., 2, 1], R[..., 2, 2]), np.arctan2(R[..., 1, 2], R[..., 1, 1]))
    c = np.where(free, np.arctan2(-R[..., 1, 0], R[..., 0, 0]), 0.0)
    return np.stack([a, np.arctan2(R[..., 2, 0], cos_b), c], axis=-1)


def pixels_from_uv(UV: Floats) -> Array:
    """Return our pixels (x, y) of the thesis' image points (U, V), (..., 2): x = V, y = U."""
    return np.asarray(UV, dtype=np.float64)[..., ::-1]


def uv_from_pixels(q: Floats) -> Array:
    """Return the thesis' image points (U, V) of our pixels (x, y), (..., 2)."""
    return np.asarray(q, dtype=np.float64)[..., ::-1]


def uv_matrix(camera: Camera, camera_from_world: Rigid) -> Array:
    """Return the 3x4 matrix (U, V, 1) ~ C (X, Y, Z, 1) of a camera and pose, in the scale of K (row 2 is the depth)."""
    P = camera.K @ np.column_stack([camera_from_world.rotation, camera_from_world.translation])
    return np.asarray(PIXEL_FROM_UV @ P)


def uv_from_pixel_matrix(P: Floats) -> Array:
    """Return the thesis' C (rows U, V, 1) of a 3x4 matrix P with rows (x, y, 1), or vice versa."""
    return np.asarray(PIXEL_FROM_UV @ frozen(P, "projection matrix", (3, 4)))


def _refuse_singular(M: Array) -> None:
    rows = np.linalg.norm(M, axis=1)
    if not rows.all():
        raise DegenerateGeometry(f"row {int(np.argmin(rows))} of M = C[:, :3] is zero: not a pinhole camera")
    volume = abs(np.linalg.det(M / rows[:, None]))
    if volume < 1e-14:
        raise DegenerateGeometry(
            f"M = C[:, :3] has no inverse (volume of its unit rows {volume:.2g}): the focal centre is at infinity "
            "or the matrix is a plane's 3x3 in disguise"
        )
