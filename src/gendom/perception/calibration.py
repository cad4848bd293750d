"""Camera pose calibration: T_world_camera from pictures of a board that the robot holds.

The board is a ChArUco board at an unknown position on the gripper. For each
picture i, with the robot's pose T_world_gripper,i,

    T_world_camera T_camera_board,i = T_world_gripper,i T_gripper_board,

which is hand-eye calibration. A first solution comes from Park and Martin (1994), "Robot sensor
calibration: solving AX = XB on the Euclidean group", through OpenCV. Both unknown transforms are
then refined by minimising the reprojection error of all corners.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.datasets import Fault
from gendom.errors import GendomError, RecordingError
from gendom.perception.camera import Camera, rigid
from gendom.perception.png import read_png
from gendom.reading import inside, read_rows, read_toml

MIN_PICTURES = 5
MIN_TURN = 5.0
"""The board must turn by this much about each of two axes [degrees], RMS over all pairs."""
MAX_RMS = 2.0
"""Above this reprojection error [pixels] poses and pictures do not belong together."""
MAX_SIGMA = 0.005
"""Above this standard deviation of the camera's position [m] the pictures do not determine it."""

_MIN_CORNERS = 6
_MIN_PIXEL_SIGMA = 0.1  # corners are hardly found better [pixels]
_COLUMNS = ("picture", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, kw_only=True)
class Board:
    """A ChArUco board: a chessboard with a marker in each white square."""

    squares_x: int
    """Columns of squares."""
    squares_y: int
    """Rows of squares."""
    square: float
    """Side of a square, as printed [m]."""
    marker: float
    """Side of a marker, as printed [m]."""
    dictionary: str = "DICT_5X5_100"
    """OpenCV's name of the markers."""
    legacy: bool = False
    """Printed by OpenCV before 4.6, with an even number of rows."""

    def __post_init__(self):
        what = f"{self.squares_x} x {self.squares_y} squares"
        some = all(3 <= n <= 100 and isinstance(n, int) for n in (self.squares_x, self.squares_y))
        require(some, what, where="board", fix="use 3 or more, 100 at most", error=GendomError)
        what = f"square {self.square}, marker {self.marker}"
        fix = "give metres, the marker smaller than the square"
        right = 0.0 < self.marker < self.square < 1.0
        require(right, what, where="board", fix=fix, error=GendomError)

    def opencv(self) -> Any:
        """The same as cv2.aruco.CharucoBoard.

        Raises:
            GendomError: There is no such dictionary.
        """
        import cv2

        number = getattr(cv2.aruco, str(self.dictionary), None)
        if not str(self.dictionary).startswith("DICT_") or number is None:
            what = f"there is no dictionary {self.dictionary!r}"
            fix = "use OpenCV's names, such as DICT_4X4_50 or DICT_5X5_100"
            raise GendomError(what, where="board", fix=fix)
        board = cv2.aruco.CharucoBoard(
            (self.squares_x, self.squares_y),
            self.square,
            self.marker,
            cv2.aruco.getPredefinedDictionary(number),
        )
        board.setLegacyPattern(self.legacy)
        return board


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board's corners in one picture, and the gripper's pose."""

    name: str
    """What messages call it."""
    points: npt.NDArray[np.float64]
    """[n, 3] the corners on the board [m]."""
    pixels: npt.NDArray[np.float64]
    """[n, 2] the same in the picture."""
    T_world_gripper: npt.NDArray[np.float64]
    """[4, 4] gripper to world [m]."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera's pose and its uncertainty."""

    T_world_camera: npt.NDArray[np.float64]
    """[4, 4] camera to world [m]."""
    T_gripper_board: npt.NDArray[np.float64]
    """[4, 4] board to gripper [m]."""
    rms: float
    """Reprojection error of all corners [pixels]."""
    rms_by_picture: dict[str, float]
    """The same of each picture [pixels]."""
    sigma_position: float
    """Standard deviation of the camera's position [m]."""
    sigma_angle: float
    """Standard deviation of its direction [degrees]."""


def find_board(picture: npt.NDArray[np.uint8], board: Board) -> tuple[np.ndarray, np.ndarray]:
    """The board's inner corners in a grey picture [height, width].

    Returns:
        Points [n, 3] on the board [m] and pixels [n, 2]; n is 0 where fewer than 6 are found or
        all on one line.
    """
    import cv2

    model = board.opencv()
    refined = cv2.aruco.CharucoParameters()
    refined.tryRefineMarkers = True
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(model, refined).detectBoard(picture)
    none = np.zeros((0, 3)), np.zeros((0, 2))
    if ids is None or len(ids) < _MIN_CORNERS or model.checkCharucoCornersCollinear(ids):
        return none
    points = np.asarray(model.getChessboardCorners(), np.float64)[np.asarray(ids, np.int64).ravel()]
    pixels = pixels.reshape(-1, 2)
    # Once more in a window that ends where the markers begin, on a picture smoothed by a pixel:
    # on rendered boards that halves the detector's own error.
    spacing = np.median(KDTree(pixels).query(pixels, k=2)[0][:, 1])
    gap = 0.5 * (1.0 - board.marker / board.square) * spacing
    half = int(np.clip(gap, 2, 10))
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    cv2.cornerSubPix(cv2.GaussianBlur(picture, (0, 0), 1.0), pixels, (half, half), (-1, -1), stop)
    return points, pixels.astype(np.float64)


def calibrate(camera: Camera, views: Sequence[BoardView]) -> Calibration:
    """`T_world_camera` from the board's corners at known poses of the gripper.

    Args:
        camera: Its intrinsics and distortion; its pose is not used.
        views: At least five, with the board turned about two axes.

    Raises:
        GendomError: Too few pictures; the poses turn the board too little or about one axis
            only, which leaves the camera's place open; or poses and pictures do not fit.
    """
    import cv2

    what = f"the board is found in {len(views)} pictures, {MIN_PICTURES} are needed"
    fix = "take more, with the board large and sharp in the picture"
    require(len(views) >= MIN_PICTURES, what, fix=fix, error=GendomError)
    _check_turns(views)
    start, hold = _hand_eye(camera, views)
    distortion = np.array(camera.distortion)

    def residual(change: np.ndarray) -> np.ndarray:
        T_camera_world = np.linalg.inv(_moved(start, change[:6]))
        T_gripper_board = _moved(hold, change[6:])
        errors = []
        for view in views:
            T = T_camera_world @ view.T_world_gripper @ T_gripper_board
            rotation = Rotation.from_matrix(T[:3, :3]).as_rotvec()
            pixels, _ = cv2.projectPoints(view.points, rotation, T[:3, 3], camera.K, distortion)
            errors.append((pixels.reshape(-1, 2) - view.pixels).ravel())
        return np.concatenate(errors)

    # Radians and metres in one vector: the columns' own sizes make them comparable.
    found = least_squares(residual, np.zeros(12), x_scale="jac", method="lm")
    lengths = np.cumsum([2 * len(view.points) for view in views])[:-1]
    by_picture = {
        view.name: float(np.sqrt(2.0 * np.mean(part**2)))
        for view, part in zip(views, np.split(found.fun, lengths), strict=True)
    }
    rms = float(np.sqrt(2.0 * np.mean(found.fun**2)))
    worst = max(by_picture, key=lambda name: by_picture[name])
    what = f"the corners are {rms:.2g} pixels from where the robot's poses put them, most in "
    what += f"{worst} ({by_picture[worst]:.2g})"
    fix = "check that poses belong to the pictures, K to the stream, and the board's sizes"
    require(rms <= MAX_RMS, what, fix=fix, error=GendomError)
    sigma = max(rms / np.sqrt(2.0), _MIN_PIXEL_SIGMA)
    singular, V = np.linalg.svd(found.jac, full_matrices=False)[1:]
    with np.errstate(divide="ignore"):
        variance = sigma**2 * ((V / singular[:, None]) ** 2).sum(axis=0)
    position, angle = np.sqrt(variance[3:6].sum()), np.sqrt(variance[:3].sum())
    what = f"the poses leave the camera's place open by {1e3 * position:.3g} mm"
    fix = "take more pictures, with the board turned more and at different places"
    require(position <= MAX_SIGMA, what, fix=fix, error=GendomError)
    return Calibration(
        T_world_camera=_moved(start, found.x[:6]),
        T_gripper_board=_moved(hold, found.x[6:]),
        rms=rms,
        rms_by_picture=by_picture,
        sigma_position=float(position),
        sigma_angle=float(np.degrees(angle)),
    )


def _hand_eye(camera: Camera, views: Sequence[BoardView]) -> tuple[np.ndarray, np.ndarray]:
    """First T_world_camera and T_gripper_board, [4, 4] each, in closed form."""
    import cv2

    boards = [_board_pose(camera, view) for view in views]
    # OpenCV solves for a camera on the gripper. For one that looks at the gripper the roles of
    # world and gripper change, so the robot's poses go in inverted.
    inverse = [np.linalg.inv(view.T_world_gripper) for view in views]
    R, t = cv2.calibrateHandEye(
        [T[:3, :3] for T in inverse],
        [T[:3, 3] for T in inverse],
        [T[:3, :3] for T in boards],
        [T[:3, 3] for T in boards],
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    T_world_camera = rigid(R, t)
    holds = [T @ T_world_camera @ board for T, board in zip(inverse, boards, strict=True)]
    mean = Rotation.from_matrix([T[:3, :3] for T in holds]).mean()
    return T_world_camera, rigid(mean.as_matrix(), np.median([T[:3, 3] for T in holds], axis=0))


def _moved(T: np.ndarray, change: np.ndarray) -> np.ndarray:
    """T turned about its own axes by change[:3] [rad], moved in the outer ones by change[3:]."""
    moved = T.copy()
    moved[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(change[:3]).as_matrix()
    moved[:3, 3] += change[3:]
    return moved


def _check_turns(views: Sequence[BoardView]) -> None:
    """Whether the gripper turns about two axes.

    About one axis only, the camera's place along it is open (Tsai and Lenz, 1989).
    """
    R = Rotation.from_matrix([view.T_world_gripper[:3, :3] for view in views])
    turns = np.concatenate([(R[i].inv() * R[i + 1 :]).as_rotvec() for i in range(len(views) - 1)])
    squares = np.linalg.eigvalsh(turns.T @ turns / len(turns))
    second, first = np.degrees(np.sqrt(np.maximum(squares, 0.0)))[1:]
    how = "hardly turn the board" if first < MIN_TURN else "turn the board about one axis only"
    what = f"the poses {how}: {first:.2g} degrees about one axis, {second:.2g} about a second"
    fix = "tilt it by 20 degrees or more, to the sides as well as forwards and back"
    require(second >= MIN_TURN, what, fix=fix, error=GendomError)


def _board_pose(camera: Camera, view: BoardView) -> np.ndarray:
    """T_camera_board [4, 4] from one picture."""
    import cv2

    found, rotation, t = cv2.solvePnP(
        view.points, view.pixels, camera.K, np.array(camera.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    what = "no pose fits the corners"
    require(found, what, where=view.name, fix="leave it out", error=GendomError)
    return rigid(Rotation.from_rotvec(rotation.ravel()).as_matrix(), t)


def read_views(
    folder: str | os.PathLike, camera: Camera, *, on_warning: Callable[[Fault], None]
) -> list[BoardView]:
    """The views of a folder with board.toml, poses.csv and pictures.

    board.toml has the fields of `Board`; poses.csv the columns picture,x,y,z,qx,qy,qz,qw: a PNG
    file in the folder and T_world_gripper at that moment, metres and a unit quaternion.

    Args:
        folder: Where they are.
        camera: What took the pictures.
        on_warning: Called for each picture that is left out: damaged, or without the board.

    Raises:
        GendomError: board.toml or poses.csv is missing or malformed, or a picture has not the
            camera's size.
    """
    folder = Path(folder)
    board = read_board(folder / "board.toml")
    views = []
    for path, T in _read_poses(folder / "poses.csv"):
        try:
            picture = read_png(path)
        except RecordingError as error:
            on_warning(Fault(f"{error.what}; left out", str(path), error.fix or "", "warning"))
            continue
        size = camera.width, camera.height
        what = f"is {picture.width} x {picture.height}, the camera {size[0]} x {size[1]}"
        fix = "take the pictures with the stream whose K is given"
        require(picture.size == size, what, where=str(path), fix=fix, error=RecordingError)
        points, pixels = find_board(np.asarray(picture.convert("L")), board)
        if len(points) == 0:
            fix = "have it large, sharp and flat in the picture; check board.toml"
            if board.squares_y % 2 == 0 and not board.legacy:
                fix += ", with legacy = true for a board of OpenCV before 4.6 or calib.io"
            on_warning(Fault("the board is not found; left out", str(path), fix, "warning"))
            continue
        views.append(BoardView(path.name, points, pixels, T))
    return views


def read_board(path: str | os.PathLike) -> Board:
    """The board of a file board.toml with the fields of `Board`.

    Raises:
        GendomError: The file is missing or malformed.
    """
    path = Path(path)
    fix = "give squares_x, squares_y, square, marker (m), dictionary"
    fields = read_toml(path, fix=fix)
    try:
        return Board(**fields)
    except TypeError as error:  # a field that is missing, unknown or of another type
        what = f"does not describe a board ({str(error).removeprefix('Board.__init__() ')})"
        raise GendomError(what, where=str(path), fix=fix) from None
    except GendomError as error:
        raise GendomError(error.what, where=str(path), fix=error.fix) from None


def _read_poses(path: Path) -> list[tuple[Path, np.ndarray]]:
    """Pictures and T_world_gripper [4, 4] of poses.csv."""
    lines = read_rows(path, header=",".join(_COLUMNS))

    def wanted(holds: Any, what: str, where: str, fix: str) -> None:
        require(holds, what, where=where, fix=fix, error=RecordingError)

    right = tuple(lines[0][1]) == _COLUMNS
    wanted(right, "has another header", str(path), f"write {','.join(_COLUMNS)}")
    poses = []
    for number, row in lines[1:]:
        where = f"{path}, line {number}"
        try:
            values = np.array([float(text) for text in row[1:]])
        except ValueError:
            values = np.array([])
        right = len(values) == 7 and np.isfinite(values).all()
        wanted(right, "is no pose", where, "give a picture and 7 numbers")
        length, distance = np.linalg.norm(values[3:]), np.linalg.norm(values[:3])
        fix = "give a unit quaternion, qx, qy, qz, qw"
        wanted(abs(length - 1.0) <= 0.01, f"quaternion of length {length:.3g}", where, fix)
        what = f"is {distance:.4g} m from the robot's base"
        wanted(distance <= 20.0, what, where, "give metres, not millimetres")
        picture = inside(path.parent, row[0], where=where)
        poses.append((picture, rigid(Rotation.from_quat(values[3:]).as_matrix(), values[:3])))
    return poses
