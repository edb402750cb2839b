"""Solves one calibration with mrcal. Run as a script, by the interpreter that has mrcal.

It stands alone: the standard library, numpy and mrcal only, of whatever age. It reads
``request.npz`` in the folder named on the command line and leaves ``reply.npz`` there. What the
arrays are is said in `calib.images.mrcal.solves`, the other end.

The stages are those of mrcal's own tool mrcal-calibrate-cameras (https://mrcal.secretsauce.net,
"How to run a calibration"): a stereographic seed, the poses, the focal length, the lens with
outlier rejection, the deformation of the board.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    # Not in numpy before 1.21, and the system's may be older.
    from numpy.typing import NDArray

MISSING = 4
"""Exit status when mrcal cannot be imported."""

SEED_DISTORTION = 1e-6
"""Distortions start this near 0: at 0 itself some of their gradients vanish."""

FREE_GAIN = 10.0
"""Twice the gain in log likelihood that a fit without regularisation must bring: three parameters
that are not needed bring 3, and more than 10 in 2 % of cases."""

SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
"""Where Debian and its kin install mrcal; mrcal 2.2 does not tell its version."""

OPEN = 1e-10
"""Share of the greatest variance, unknowns scaled, below which rounding may have made another: the
corners leave some direction open, in which the unknowns run off together."""

CORE = 4
"""Leading intrinsics fx, fy, cx, cy, which every lens model of mrcal has."""


class Problem:
    """One optimisation: mrcal's inputs under the names of the mrcal at hand.

    Its arrays are updated in place by each `optimize`; a corner found to be an outlier gets a
    negative weight.
    """

    def __init__(self, mrcal: Any, request: dict[str, Any], header: dict[str, Any]) -> None:
        self.mrcal = mrcal
        new_names = hasattr(mrcal.cameramodel, "rt_cam_ref")
        self.cameras_key = "rt_cam_ref" if new_names else "extrinsics_rt_fromref"
        self.frames_key = "rt_ref_frame" if new_names else "frames_rt_toref"
        frame, camera = request["indices"].T
        self.inputs: dict[str, Any] = {
            "observations_board": request["observations"],
            # A camera's place among the extrinsics is one less: the first one is the origin.
            "indices_frame_camintrinsics_camextrinsics": np.ascontiguousarray(
                np.stack([frame, camera, camera - 1], axis=-1), dtype=np.int32
            ),
            "points": None,
            "observations_point": None,
            "indices_point_camintrinsics_camextrinsics": None,
            "imagersizes": request["image_sizes"].astype(np.int32),
            "calibration_object_spacing": header["square_mm"],
            "verbose": False,
        }

    def start(self, request: dict[str, Any], focal_px: list[float]) -> None:
        """Put in the caller's starting values, or mrcal's own estimate."""
        if "start_intrinsics" in request:
            intrinsics = request["start_intrinsics"]
            cameras, frames = request["start_cameras"], request["start_frames"]
        else:
            intrinsics, cameras, frames = self.mrcal.seed_stereographic(
                imagersizes=self.inputs["imagersizes"],
                focal_estimate=focal_px,
                indices_frame_camera=np.ascontiguousarray(
                    self.inputs["indices_frame_camintrinsics_camextrinsics"][:, :2]
                ),
                observations=self.inputs["observations_board"],
                object_spacing=self.inputs["calibration_object_spacing"],
            )
        self.inputs["intrinsics"] = np.ascontiguousarray(intrinsics)
        self.inputs[self.cameras_key] = np.ascontiguousarray(cameras)
        self.inputs[self.frames_key] = np.ascontiguousarray(frames)

    def optimize(
        self, lens_model: str, *, core: bool, lens: bool, reject: bool, regularise: bool = True
    ) -> None:
        """Minimise from where the last call stopped; poses are always free."""
        self.inputs.update(
            lensmodel=lens_model,
            do_optimize_intrinsics_core=core,
            do_optimize_intrinsics_distortions=lens,
            do_optimize_extrinsics=True,
            do_optimize_frames=True,
            do_apply_regularization=core and lens and regularise,
            do_apply_outlier_rejection=reject,
        )
        self.mrcal.optimize(**self.inputs)

    def solve_lens(self, lens_model: str) -> None:
        """Free poses, focal length and lens, one after the other."""
        stereographic = "LENSMODEL_STEREOGRAPHIC"
        self.inputs.update(calobject_warp=None, do_optimize_calobject_warp=False)
        self.optimize(stereographic, core=False, lens=False, reject=False)
        self.optimize(stereographic, core=True, lens=False, reject=False)
        core = self.inputs["intrinsics"][:, :CORE]
        count = self.mrcal.lensmodel_num_params(lens_model) - CORE
        lens = SEED_DISTORTION * (2 * np.random.random((len(core), count)) - 1)  # noqa: NPY002 - mrcal itself draws from this generator
        self.inputs["intrinsics"] = np.concatenate([core, lens], axis=-1)
        self.optimize(lens_model, core=True, lens=True, reject=True)

    def free_lens(self, lens_model: str) -> None:
        """Solve once more without mrcal's regularisation, and keep that if it fits better.

        It pulls the coefficients towards 0, which those of a rational lens may be far from: on a
        lens of 100 deg seen with 0.05 px it bent the model by 1 px. Where they need not be, it
        keeps them from running off along a valley of equal cost.
        """
        kept = {key: np.array(v) for key, v in self.inputs.items() if isinstance(v, np.ndarray)}
        before = self.cost()
        self.optimize(lens_model, core=True, lens=True, reject=False, regularise=False)
        count = 2 * int((self.inputs["observations_board"][..., 2] > 0).sum())
        singular = self.mrcal.optimizer_callback(**self.inputs)[3] is None
        if singular or count * np.log(before / self.cost()) < FREE_GAIN:
            self.inputs.update(kept, do_apply_regularization=True)

    def cost(self) -> float:
        """Return the sum of squared residuals of the corners in use, px^2."""
        used = self.inputs["observations_board"][..., 2] > 0
        x = self.mrcal.optimizer_callback(**self.inputs)[1][: 2 * used.size]
        return float((x.reshape(*used.shape, 2)[used] ** 2).sum())

    def free_board(self) -> None:
        """Let the board warp from now on."""
        self.inputs.update(calobject_warp=np.zeros(2), do_optimize_calobject_warp=True)


def linearise(problem: Problem, columns: list[int]) -> dict[str, Any]:
    """Return residuals, degrees of freedom and the covariance of some state variables.

    The covariance is that of an estimate by the corners alone under equal, independent noise of
    every coordinate, (J'J)^-1 sigma^2 with J the jacobian of the corner residuals. mrcal's
    regularisation is no knowledge of the lens: where it decides a coefficient, the estimate hardly
    scatters and is wrong all the same (k2 of lenses of 20 deg stood 3 of its standard deviations
    off). The estimate itself lies where the corners like it as well as their own minimum
    (`Problem.free_lens`), so this covariance holds for it.

    Where the corners leave a direction open it is that of the regularised estimate instead: with M
    the jacobian of all residuals, (M'M)^-1 J'J (M'M)^-1 sigma^2 (mrcal's documentation,
    "Uncertainty", where M'M is factorised once).
    """
    inputs = problem.inputs
    state, x, jacobian, regularised = problem.mrcal.optimizer_callback(**inputs)
    observations = inputs["observations_board"]
    used = observations[..., 2] > 0
    count = 2 * used.size
    residuals = -x[:count].reshape(*used.shape, 2)
    residuals[~used] = np.nan
    freedom = max(1, 2 * int(used.sum()) - len(state))
    sigma = float(np.sqrt(np.nansum(residuals**2) / freedom))
    reply: dict[str, Any] = {"residuals": residuals, "sigma_px": sigma}
    if not columns:
        return reply
    if regularised is None:
        raise ValueError("the normal equations are singular: some parameter is not determined")
    scale = np.ones(len(state))
    problem.mrcal.unpack_state(scale, **inputs)
    gradient = np.zeros((len(columns), len(state)))
    gradient[np.arange(len(columns)), columns] = scale[columns]

    def covariance(factorization: Any) -> NDArray[np.float64]:
        spread = jacobian[:count] @ factorization.solve_xt_JtJ_bt(gradient).T
        return np.asarray(spread.T @ spread * sigma**2)

    alone = problem.mrcal.optimizer_callback(**{**inputs, "do_apply_regularization": False})[3]
    own = None if alone is None else covariance(alone)
    closed = own is not None and determined(own)
    reply["covariance"] = own if closed else covariance(regularised)
    return reply


def determined(covariance: NDArray[np.float64]) -> bool:
    """Return whether a covariance is one of unknowns that are all determined, numbers included."""
    variance = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variance > 0).all()):
        return False
    spread = np.sqrt(variance)
    value = np.linalg.eigvalsh(covariance / np.outer(spread, spread))
    return bool(value[0] > OPEN * value[-1])


def state_columns(problem: Problem, lens: bool) -> list[int]:
    """Return the places in mrcal's state of the intrinsics, if free, and of the second camera."""
    mrcal, inputs = problem.mrcal, problem.inputs
    columns: list[int] = []
    cameras, count = inputs["intrinsics"].shape
    if lens:
        for camera in range(cameras):
            first = mrcal.state_index_intrinsics(camera, **inputs)
            columns += range(first, first + count)
    if cameras > 1:
        first = mrcal.state_index_extrinsics(0, **inputs)
        columns += range(first, first + 6)
    return columns


def lens_grid(problem: Problem, shape: tuple[int, int]) -> dict[str, Any]:
    """Return the rays of a grid of pixels of each camera, and how uncertain their pixels are.

    The uncertainty is the standard deviation in the worst direction, px, of where a point on the
    ray, as far away as the boards were, is projected.
    """
    mrcal, inputs = problem.mrcal, problem.inputs
    distance = float(np.median(np.linalg.norm(inputs[problem.frames_key][:, 3:], axis=-1)))
    pixels, rays, stds, texts = [], [], [], []
    for camera, (width, height) in enumerate(inputs["imagersizes"]):
        model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=camera)
        u, v = np.meshgrid(
            np.linspace(0, width - 1, shape[1]), np.linspace(0, height - 1, shape[0])
        )
        grid = np.stack([u, v], axis=-1)
        directions = mrcal.unproject(grid, *model.intrinsics(), normalize=True)
        stds.append(
            mrcal.projection_uncertainty(directions * distance, model, what="worstdirection-stdev")
        )
        pixels.append(grid)
        rays.append(directions)
        model.write(f"camera{camera}.cameramodel")
        texts.append(Path(f"camera{camera}.cameramodel").read_text(encoding="utf-8"))
    return {
        "grid_pixels": np.stack(pixels),
        "grid_rays": np.stack(rays),
        "grid_std": np.stack(stds),
        "models": np.array(texts),
    }


def solve(mrcal: Any, request: dict[str, Any], header: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of the reply."""
    lens_model: str = header["lens_model"]
    hold: bool = header["hold_intrinsics"]
    problem = Problem(mrcal, request, header)
    missing = ~np.isfinite(request["observations"]).all(axis=-1)
    problem.start(request, header["focal_px"])
    if hold:
        problem.inputs.update(calobject_warp=None, do_optimize_calobject_warp=False)
        problem.optimize(lens_model, core=False, lens=False, reject=True)
    elif "start_intrinsics" in request:
        problem.inputs.update(calobject_warp=None, do_optimize_calobject_warp=False)
        problem.optimize(lens_model, core=True, lens=True, reject=True)
    else:
        problem.solve_lens(lens_model)
    if header["warp"]:
        problem.free_board()
        problem.optimize(lens_model, core=not hold, lens=not hold, reject=True)
    splined = "SPLINED" in lens_model
    if not (hold or splined):
        problem.free_lens(lens_model)
    inputs = problem.inputs
    columns = [] if splined else state_columns(problem, not hold)
    reply = linearise(problem, columns)
    if not hold:
        reply.update(lens_grid(problem, tuple(header["grid"])))
    weights = inputs["observations_board"][..., 2]
    warp = inputs["calobject_warp"]
    reply.update(
        intrinsics=inputs["intrinsics"],
        cameras=inputs[problem.cameras_key],
        frames=inputs[problem.frames_key],
        rejected=(weights <= 0) & ~missing,
        warp=np.zeros(0) if warp is None else warp,
        version=np.array(version_of(mrcal)),
    )
    return reply


def version_of(mrcal: Any) -> str:
    """Return what mrcal says, or the system's package manager, or "unknown"."""
    if hasattr(mrcal, "__version__"):
        return str(mrcal.__version__)
    if SYSTEM_PACKAGES not in Path(mrcal.__file__).parents:
        return "unknown"
    query = ["dpkg-query", "--show", "--showformat=${Version}", "python3-mrcal"]
    try:
        told = subprocess.run(query, capture_output=True, text=True, check=True)  # noqa: S603 - fixed words
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{told.stdout} (python3-mrcal of the system)"


def end_with_parent() -> None:
    """Let this process end with the one that started it: `calib.core.parent`, which is not here."""
    parent = os.environ.pop("CALIB_PARENT", "")
    if not parent or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    try:
        os.kill(int(parent), 0)
    except ProcessLookupError:
        os.kill(os.getpid(), signal.SIGKILL)


def main(folder: Path) -> int:
    """Answer the request in `folder`; return the exit status."""
    end_with_parent()
    try:
        import mrcal
    except Exception as error:  # a build for another numpy raises what it likes
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return MISSING
    with np.load(folder / "request.npz", allow_pickle=False) as file:
        request = {name: file[name] for name in file.files}
    header = json.loads(str(request.pop("header")))
    np.random.seed(header["seed"])  # noqa: NPY002 - mrcal itself draws from this generator
    np.savez(folder / "reply.npz", **solve(mrcal, request, header))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
