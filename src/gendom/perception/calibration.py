"""Camera pose calibration: T_world_camera from pictures of a board that the robot holds.

The board is a ChArUco board at an unknown position on the gripper. For each
picture i, with the robot's pose T_world_gripper,i,

    T_world_camera T_camera_board,i = T_world_gripper,i T_gripper_board,

which is hand-eye calibration. A first solution comes from Shah (2013), "Solving the
robot-world/hand-eye calibration problem using the Kronecker product", through OpenCV. Both unknown
transforms are then refined by minimising the reprojection error of all corners, robustly.

The stated errors hold nine times out of ten. They are Student's quantile of the root of two sums
of squares: the scatter of fits without one view each (jackknife; Efron, 1982), and the shift of the
pose where the focal length, the board's scale and the principal point are free, since what is wrong
in all views alike no residual shows.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from gendom.arrays import Array, rigid
from gendom.datasets import Fault
from gendom.errors import RecordingError
from gendom.perception.camera import MAX_DISTANCE, Camera, expect
from gendom.perception.frames import read_png
from gendom.reading import inside, number_of, read_rows, read_toml, record_of

# What is refused (docs/perception.md).
_MIN_PICTURES = 5
_MIN_TURN = 5.0  # degrees about each of two axes, RMS over all pairs
_MAX_RMS = 2.0  # [pixels]; reprojection error of the median view
_MAX_ERROR = 0.02  # [m]; stated error of the camera's position
_MAX_SCALE, _MAX_CENTRE = 0.005, 3.0  # [-], [pixels]; by more, and three deviations, scales or the
# principal point differ where they are free

_MIN_CORNERS = 6
_DOUBTED = 0.5  # above this error of the median view [pixels] other readings of poses are tried
_ROBUST = 0.3  # residuals above this [pixels] count linearly
_POSE, _ALL = 12, 16  # unknowns: of both poses; with focal length, board's scale and centre
_PRIOR = np.array([0.01, 0.01, 5.0, 5.0])  # deviations of the last four [-], [-], [pixels]
COLUMNS = ("picture", "x", "y", "z", "qx", "qy", "qz", "qw")


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
        expect(some, what, where="board.toml", fix="use 3 or more, 100 at most")
        what = f"square {self.square}, marker {self.marker}"
        fix = "give metres, the marker smaller than the square"
        expect(0.0 < self.marker < self.square < 1.0, what, where="board.toml", fix=fix)

    def opencv(self) -> Any:
        """The same as cv2.aruco.CharucoBoard; RecordingError: there is no such dictionary."""
        from cv2 import aruco

        known = self.dictionary.startswith("DICT_") and hasattr(aruco, self.dictionary)
        fix = "use OpenCV's names, such as DICT_4X4_50 or DICT_5X5_100"
        what = f"there is no dictionary {self.dictionary!r}"
        expect(known, what, where="board.toml", fix=fix)
        markers = aruco.getPredefinedDictionary(getattr(aruco, self.dictionary))
        size = self.squares_x, self.squares_y
        board = aruco.CharucoBoard(size, self.square, self.marker, markers)
        board.setLegacyPattern(self.legacy)
        return board


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board's corners in one picture, and the gripper's pose."""

    name: str
    """What messages call it."""
    points: Array
    """[n, 3] the corners on the board [m]."""
    pixels: Array
    """[n, 2] the same in the picture."""
    T_world_gripper: Array
    """[4, 4] gripper to world [m]."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera's pose and its uncertainty."""

    T_world_camera: Array
    """[4, 4] camera to world [m]."""
    T_gripper_board: Array
    """[4, 4] board to gripper [m]."""
    rms: float
    """Reprojection error of all corners [pixels]."""
    rms_by_picture: dict[str, float]
    """The same of each picture [pixels]."""
    error_position: float
    """Stated error of the camera's position [m]."""
    error_angle: float
    """Of its direction [degrees]; nine times out of ten both are smaller."""
    refit: dict[str, tuple[float, float]]
    """Value and standard deviation of ``focal_length`` [pixels], ``board_scale`` (squares over the
    stated ones), ``centre_x`` and ``centre_y`` [pixels] where they are free."""

    @property
    def outliers(self) -> list[str]:
        """Pictures that fit by far worse than most."""
        usual = float(np.median(list(self.rms_by_picture.values())))
        return [name for name, r in self.rms_by_picture.items() if r > max(5.0 * usual, 1.0)]


def find_board(picture: npt.NDArray[np.uint8], board: Board) -> tuple[np.ndarray, np.ndarray]:
    """The board's inner corners in a grey picture [height, width]: points [n, 3] on the board [m]
    and pixels [n, 2]; n is 0 where fewer than 6 are found or all on one line."""
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
        RecordingError: Too few pictures; the poses turn the board too little or about one axis
            only, which leaves the camera's place open; poses and pictures do not fit, or fit if
            they are read otherwise; or they fit another focal length, board or centre.
    """
    what = f"the board is found in {len(views)} pictures, {_MIN_PICTURES} are needed"
    fix = "take more, with the board large and sharp in the picture"
    expect(len(views) >= _MIN_PICTURES, what, fix=fix)
    _check_turns(views)
    problem = _HandEyeProblem(camera, views)
    x, covariance = problem.fit(np.zeros(_POSE))
    by_view = problem.rms(x)
    typical = float(np.median(by_view))
    if typical > _DOUBTED:
        _check_readings(camera, views, typical)
    free, free_covariance = problem.fit(np.pad(x, (0, _ALL - _POSE)))
    refit = _refit(camera, free, np.sqrt(np.diag(free_covariance)))
    if np.median(problem.rms(free)) <= _MAX_RMS:
        _check_refit(camera, refit)
    worst = int(np.argmax(by_view))
    what = f"the corners are {typical:.2g} pixels from where the robot's poses put them, most in "
    what += f"{views[worst].name} ({by_view[worst]:.2g})"
    fix = "check that poses belong to the pictures, K to the stream, and the board's sizes"
    expect(typical <= _MAX_RMS, what, fix=fix)
    squares = np.diag(covariance)[:6] + (free[:6] - x[:6]) ** 2
    quantile = stdtrit(len(views) - 1, 0.95)
    angle, position = quantile * np.sqrt(squares.reshape(2, 3).sum(axis=1))
    T_world_camera, T_gripper_board = problem.poses(x)
    found = Calibration(
        T_world_camera=T_world_camera,
        T_gripper_board=T_gripper_board,
        rms=float(np.sqrt(2.0 * np.mean(problem.residual(x) ** 2))),
        rms_by_picture={view.name: float(r) for view, r in zip(views, by_view, strict=True)},
        error_position=float(position),
        error_angle=float(np.degrees(angle)),
        refit=refit,
    )
    what = f"the poses leave the camera's place open by {1e3 * position:.3g} mm"
    fix = "take more pictures, with the board turned more and at different places"
    if odd := found.outliers:
        fix += f"; and leave out {', '.join(odd)}, {by_view.max():.2g} pixels off"
    expect(position <= _MAX_ERROR, what, fix=fix)
    return found


class _HandEyeProblem:
    """Least squares over x: changes of both poses (`_moved`) from their first values, and where x
    is longer ln of focal length and board over the stated ones, and the centre's shift [pixels]."""

    def __init__(self, camera: Camera, views: Sequence[BoardView]):
        self.camera = camera
        self.T_world_gripper = np.stack([view.T_world_gripper for view in views])
        self.points = np.concatenate([view.points for view in views])
        self.pixels = np.concatenate([view.pixels for view in views])
        self.view = np.repeat(np.arange(len(views)), [len(view.points) for view in views])
        self.first = _hand_eye(camera, views)

    def poses(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """T_world_camera and T_gripper_board, [4, 4] each."""
        return _moved(self.first[0], x[:6]), _moved(self.first[1], x[6:12])

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Errors of all corners [pixels], [2 n], and the prior's of what is free."""
        import cv2

        T_world_camera, T_gripper_board = self.poses(x)
        T = np.linalg.inv(T_world_camera) @ self.T_world_gripper @ T_gripper_board
        free = np.zeros(_ALL - _POSE)
        free[: len(x) - _POSE] = x[_POSE:]
        points = np.exp(free[1]) * self.points
        points = np.einsum("nij,nj->ni", T[self.view, :3, :3], points) + T[self.view, :3, 3]
        K = self.camera.K * np.exp([[free[0]], [free[0]], [0.0]])
        K[:2, 2] = self.camera.K[:2, 2] + free[2:]
        none, distortion = np.zeros(3), np.array(self.camera.distortion)
        pixels = cv2.projectPoints(points, none, none, K, distortion)[0][:, 0]
        # What the pictures leave open stays as stated: the prior counts as a few residuals.
        prior = _ROBUST * x[_POSE:] / _PRIOR[: len(x) - _POSE]
        return np.concatenate([(pixels - self.pixels).ravel(), prior])

    def rms(self, x: np.ndarray) -> np.ndarray:
        """[views] reprojection error of each [pixels]."""
        squares = (self.residual(x)[: self.pixels.size].reshape(-1, 2) ** 2).sum(axis=1)
        return np.sqrt(np.bincount(self.view, squares) / np.bincount(self.view))

    def fit(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The best x from one, and its covariance: a jackknife over views, each of whose fits is
        one Newton step from the best (Simonoff and Tsai, 1986)."""
        # Radians and metres in one vector: the columns' own sizes make them comparable.
        found = least_squares(self.residual, x, x_scale="jac", loss="soft_l1", f_scale=_ROBUST)
        # SciPy's jac is scaled so that jac^T jac is the Hessian; so scaled the gradient of view k
        # is jac_k^T residual_k.
        residual = found.fun * (1.0 + (found.fun / _ROBUST) ** 2) ** 0.25
        count, rows = len(self.T_world_gripper), np.full(len(residual), -1)
        rows[: self.pixels.size] = np.repeat(self.view, 2)
        steps = []
        for k in range(count):
            rest, own = found.jac[rows != k], found.jac[rows == k]
            steps.append(np.linalg.pinv(rest.T @ rest) @ own.T @ residual[rows == k])
        return found.x, (count - 1) / count * np.transpose(steps) @ np.array(steps)


def _refit(camera: Camera, x: np.ndarray, sd: np.ndarray) -> dict[str, tuple[float, float]]:
    """Values and deviations of what is free in x [16]."""
    f, scale, (cx, cy) = camera.K[0, 0] * np.exp(x[12]), np.exp(x[13]), camera.K[:2, 2] + x[14:]
    pairs = {
        "focal_length": (f, f * sd[12]),
        "board_scale": (scale, scale * sd[13]),
        "centre_x": (cx, sd[14]),
        "centre_y": (cy, sd[15]),
    }
    return {name: (float(v), float(d)) for name, (v, d) in pairs.items()}


def _check_refit(camera: Camera, refit: dict[str, tuple[float, float]]) -> None:
    """Refuse other intrinsics or another board's scale than the stated ones, with the likely
    cause."""
    f, (cx, cy) = camera.K[0, 0], camera.K[:2, 2]
    (own_f, df), (scale, ds), (x, dx), (y, dy) = refit.values()
    shifted = abs(x - cx) > max(_MAX_CENTRE, 3.0 * dx) or abs(y - cy) > max(_MAX_CENTRE, 3.0 * dy)
    whats, fixes = [], []
    if abs(own_f - f) > max(_MAX_SCALE * f, 3.0 * df):
        whats.append(f"a focal length of {own_f:.4g} pixels, not {f:.4g}")
        fixes.append("K is of another stream, as the colour camera's is, or of another resolution")
    elif shifted:
        fixes.append("K is of another stream or device, or the pictures are cropped")
    if abs(scale - 1.0) > max(_MAX_SCALE, 3.0 * ds):
        whats.append(f"squares {scale:.4f} times as large as board.toml says")
        fixes.append("the board is printed to another scale: measure its squares")
    if shifted:
        whats.append(f"a centre of ({x:.1f}, {y:.1f}), not ({cx:.1f}, {cy:.1f})")
    expect(not whats, f"the pictures fit {' and '.join(whats)}", fix=", and ".join(fixes))


def _check_readings(camera: Camera, views: Sequence[BoardView], typical: float) -> None:
    """Refuse poses that fit much better than by the median view's error [pixels] if they are read
    otherwise, and say how they were written."""
    readings = [(whats, _HandEyeProblem(camera, other)) for whats, other in _readings(views)]
    errors = [np.median(problem.rms(np.zeros(_POSE))) for _, problem in readings]
    whats, problem = readings[int(np.argmin(errors))]
    x, _ = problem.fit(np.zeros(_POSE))
    if np.median(problem.rms(x)) > min(0.5 * typical, _MAX_RMS):
        return
    X, Y = (np.linalg.norm(T[:3, 3]) for T in problem.poses(x))
    if "inverse" in whats:  # the same equation: what is near the gripper, camera or board?
        in_hand = "those of a camera on the gripper (eye in hand)"
        whats["inverse"] = in_hand if X < Y else "T_gripper_world, the inverse"
    what = "the poses fit the pictures only if read as " + " and ".join(whats.values())
    fix = "write T_world_gripper of each picture, x,y,z,qx,qy,qz,qw, with the camera at rest"
    raise RecordingError(what, fix=f"{fix} and the board on the gripper")


def _readings(views: Sequence[BoardView]) -> Iterator[tuple[dict[str, str], list[BoardView]]]:
    """What may be wrong in poses, and the views that are right if it is."""
    for wxyz, inverse, shift in product((False, True), (False, True), (0, 1, -1)):
        T = np.stack([view.T_world_gripper for view in views])
        whats = {}
        if wxyz:
            whats["wxyz"] = "quaternions w, x, y, z"
            read = Rotation.from_matrix(T[:, :3, :3]).as_quat()
            T[:, :3, :3] = Rotation.from_quat(np.roll(read, -1, axis=1)).as_matrix()
        if inverse:
            whats["inverse"] = ""
            T = np.linalg.inv(T)
        if shift:
            where = "below" if shift > 0 else "above"
            whats["shift"] = f"shifted by a row (each pose {where} its picture)"
        pairs = zip(views[max(-shift, 0) :], T[max(shift, 0) :], strict=False)
        if whats:
            yield whats, [replace(view, T_world_gripper=pose) for view, pose in pairs]


def _hand_eye(camera: Camera, views: Sequence[BoardView]) -> tuple[np.ndarray, np.ndarray]:
    """First T_world_camera and T_gripper_board, [4, 4] each, in closed form."""
    import cv2

    boards = np.stack([_board_pose(camera, view) for view in views])
    poses = np.stack([view.T_world_gripper for view in views])
    # T_camera_board T_board_gripper = T_camera_world T_world_gripper
    (R, t), (R_gripper, t_gripper) = ((T[:, :3, :3], T[:, :3, 3]) for T in (boards, poses))
    R_board, t_board, R_world, t_world = cv2.calibrateRobotWorldHandEye(
        [*R], [*t], [*R_gripper], [*t_gripper], method=cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH
    )
    return np.linalg.inv(rigid(R_world, t_world)), np.linalg.inv(rigid(R_board, t_board))


def _moved(T: np.ndarray, change: np.ndarray) -> np.ndarray:
    """T turned about its own axes by change[:3] [rad], moved in the outer ones by change[3:]."""
    turn = Rotation.from_rotvec(change[:3]).as_matrix()
    return rigid(T[:3, :3] @ turn, T[:3, 3] + change[3:])


def _check_turns(views: Sequence[BoardView]) -> None:
    """Whether the gripper turns about two axes.

    About one axis only, the camera's place along it is open (Tsai and Lenz, 1989).
    """
    R = Rotation.from_matrix([view.T_world_gripper[:3, :3] for view in views])
    turns = np.concatenate([(R[i].inv() * R[i + 1 :]).as_rotvec() for i in range(len(views) - 1)])
    squares = np.linalg.eigvalsh(turns.T @ turns / len(turns))
    second, first = np.degrees(np.sqrt(np.maximum(squares, 0.0)))[1:]
    how = "hardly turn the board" if first < _MIN_TURN else "turn the board about one axis only"
    what = f"the poses {how}: {first:.2g} degrees about one axis, {second:.2g} about a second"
    fix = "tilt it by 20 degrees or more, to the sides as well as forwards and back"
    expect(second >= _MIN_TURN, what, fix=fix)


def _board_pose(camera: Camera, view: BoardView) -> np.ndarray:
    """T_camera_board [4, 4] from one picture."""
    import cv2

    found, rotation, t = cv2.solvePnP(
        view.points, view.pixels, camera.K, np.array(camera.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    expect(found, "no pose fits the corners", where=view.name, fix="leave it out")
    return rigid(Rotation.from_rotvec(rotation.ravel()).as_matrix(), t)


def read_views(
    folder: str | os.PathLike, camera: Camera, *, on_warning: Callable[[Fault], None]
) -> list[BoardView]:
    """The views of a folder with board.toml, poses.csv and pictures that a camera took.

    board.toml has the fields of `Board`; poses.csv the columns picture,x,y,z,qx,qy,qz,qw: a PNG
    file in the folder and T_world_gripper at that moment, metres and a unit quaternion.
    `on_warning` is called for each picture that is left out: damaged, or without the board.

    Raises:
        RecordingError: board.toml or poses.csv is missing or malformed, a picture has not the
            camera's size, or shows the board of the other side of OpenCV 4.6.
    """
    folder = Path(folder)
    board = read_board(folder / "board.toml")
    views = []
    for path, T in read_poses(folder / "poses.csv"):
        try:
            picture = read_png(path)
        except RecordingError as error:
            on_warning(Fault(f"{error.what}; left out", str(path), error.fix or "", "warning"))
            continue
        grey = np.asarray(picture.convert("L"))
        camera.check_size(grey, str(path))
        points, pixels = find_board(grey, board)
        if len(points) == 0:
            other = replace(board, legacy=not board.legacy)
            what = f"shows a board {'before' if other.legacy else 'since'} OpenCV 4.6"
            fix = f"write legacy = {str(other.legacy).lower()} in board.toml"
            is_other = board.squares_y % 2 == 0 and len(find_board(grey, other)[0]) > 0
            expect(not is_other, what, where=str(path), fix=fix)
            fix = "have it large, sharp and flat in the picture; check board.toml"
            on_warning(Fault("the board is not found; left out", str(path), fix, "warning"))
            continue
        views.append(BoardView(path.name, points, pixels, T))
    return views


def read_board(path: Path) -> Board:
    """The board of a file board.toml with the fields of `Board`; RecordingError: it has others."""
    fix = "give squares_x, squares_y, square, marker (m), dictionary"
    table = read_toml(path, fix=fix, error=RecordingError)
    return record_of(Board, table, where=str(path), fix=fix, by_hand=True, error=RecordingError)


def read_poses(path: Path) -> list[tuple[Path, np.ndarray]]:
    """Pictures and T_world_gripper [4, 4] of poses.csv; RecordingError: it is missing or malformed,
    or holds millimetres or angles."""
    lines, fix = read_rows(path, header=",".join(COLUMNS)), f"write {','.join(COLUMNS)}"
    expect(tuple(lines[0][1]) == COLUMNS, "has another header", where=str(path), fix=fix)
    poses = []
    for number, row in lines[1:]:
        where, fix = f"{path}, line {number}", "give a picture, x, y, z and a quaternion, no angles"
        try:
            values = np.array([number_of(text) for text in row[1:]])
        except ValueError:
            values = np.array([])
        right = len(values) == 7 and np.isfinite(values).all()
        expect(right, "is no pose", where=where, fix=fix)
        length, distance = np.linalg.norm(values[3:]), np.linalg.norm(values[:3])
        what = f"quaternion of length {length:.3g}"
        what += ": angles in degrees?" if length > 2.0 * np.pi else ""
        fix = "give a unit quaternion, qx, qy, qz, qw"
        expect(abs(length - 1.0) <= 0.01, what, where=where, fix=fix)
        what, fix = f"is {distance:.4g} m from the robot's base", "give metres, not millimetres"
        expect(distance <= MAX_DISTANCE, what, where=where, fix=fix)
        picture = Path(inside(path.parent, row[0], where=where))
        poses.append((picture, rigid(Rotation.from_quat(values[3:]).as_matrix(), values[:3])))
    return poses
