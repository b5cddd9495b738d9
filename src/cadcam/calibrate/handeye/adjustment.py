"""Hand-eye calibration: the pose of a camera on a robot's flange, or in its cell, without a guess.

Eye-in-hand: the flange carries the camera and the target stands still. Eye-to-hand: the flange carries the target and
the camera stands still. Both are one problem (`cadcam.fit.hand_eye`): a thing held by the flange, a thing fixed in the
base, and n poses. The steps: the target's pose in every picture (both poses of a flat one); checks that reject
inconsistent or degenerate input; closed form over all pairs of poses; adjustment of poses with the robot's noise
estimated; adjustment of pixels, every robot pose free within that noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Mask, frozen
from cadcam.calibrate.handeye.checks import WORDS, consistent_choice, refuse_inconsistent
from cadcam.calibrate.handeye.estimate import MOUNTINGS, HandEyeEstimate, Mounting, RobotNoise
from cadcam.calibrate.handeye.held_out import held_out, scale_of_target
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import camera_of, internals_of
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, TooFewPoints
from cadcam.fit import hand_eye
from cadcam.fit.block_least_squares import BlockSolution, minimise_blocks
from cadcam.fit.hand_eye_pixels import HandEyePixels, HandEyeState, InternalsPrior
from cadcam.fit.hand_eye_poses import PATTERNS, SMALLEST, HandEyePoses, PosesFit, adjust, evaluated, smoothed
from cadcam.fit.many_poses import PaddedViews, TwoPoses, pose_jacobian, poses_of_views
from cadcam.fit.square_root import factorise
from cadcam.fit.variance_components import variance_components
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_each, expect_known

LEAST_POSES = 3
_POSE = ("x", "y", "z", "rx", "ry", "rz")
_ROUNDS = 2  # of alternating between internals and robot noise, where the internals are not fixed


@dataclass(frozen=True, slots=True, eq=False)
class _CameraData:
    """The camera's data: views, camera, noise of a pixel, poses by picture alone, and which of them are second ones."""

    observations: tuple[Observations, ...]
    views: PaddedViews
    camera: Camera
    noise_px: float
    camera_from_target: Rigid
    second: Mask


def calibrate_hand_eye(
    base_from_flange: Rigid,
    observations: Sequence[Observations],
    camera: Camera | CameraEstimate,
    *,
    mounting: Mounting,
    names: Sequence[str] = (),
) -> HandEyeEstimate:
    """Return the pose of the camera on or beside the robot, from n robot poses (mm) and n pictures of one target.

    observations: of each picture, p_world being the target's own coordinates (mm); different pictures may show
    different points. camera: its internals are held fixed; those of a `CameraEstimate` are adjusted within its
    covariance. The noise of a pixel is that stated by all observations, else estimated from the residuals of the
    pictures when each has a pose of its own. names: of the poses, for messages; default "1", "2", ...

    Raises `TooFewPoints` below three poses, `InconsistentPoses` where robot and pictures contradict each other (order,
    direction, unit, single poses: named), `DegenerateMotions` where the motions leave a direction undetermined (named).
    """
    expect(base_from_flange, "base_from_flange", Rigid)
    observations = expect_each(observations, "observations", Observations)
    expect(camera, "camera", Camera, CameraEstimate)
    labels = _checked(base_from_flange, len(observations), mounting, names)
    seen, both, dof = _seen(
        tuple(observations), camera.camera if isinstance(camera, CameraEstimate) else camera, labels
    )
    held = mounting == "eye-in-hand"
    which = consistent_choice(base_from_flange, _directed(both, held), both.sum_of_squares, dof)
    seen = replace(seen, camera_from_target=both.chosen(which), second=which > 0)
    poses = _poses(base_from_flange, seen, held)
    start = refuse_inconsistent(poses, mounting, labels)
    fit = adjust(poses, start, hand_eye.fixed_in_base(base_from_flange, start, poses.held_from_fixed))
    return _from_pixels(_adjusted(poses, fit, seen, _prior(camera), held), mounting, labels)


def calibrate_hand_eye_from_poses(
    base_from_flange: Rigid,
    camera_from_target: Rigid,
    *,
    mounting: Mounting,
    covariance: Array | None = None,
    names: Sequence[str] = (),
) -> HandEyeEstimate:
    """Return the pose of the camera, from n robot poses and n poses of the target in the camera frame (mm).

    covariance (n, 6, 6) or (6, 6): of camera_from_target @ exp(xi), mm and rad, if it is known; else all noise is
    attributed to the robot. Pixels carry more information (`calibrate_hand_eye`). Raises as that does.
    """
    expect(base_from_flange, "base_from_flange", Rigid)
    expect(camera_from_target, "camera_from_target", Rigid)
    labels = _checked(base_from_flange, _count(camera_from_target, "camera_from_target"), mounting, names)
    held = mounting == "eye-in-hand"
    poses = _as_held(base_from_flange, camera_from_target, _covariances(covariance, len(labels)), held)
    start = refuse_inconsistent(poses, mounting, labels)
    fit = adjust(poses, start, hand_eye.fixed_in_base(base_from_flange, start, poses.held_from_fixed))
    scale, scale_sigma = scale_of_target(poses, fit)
    return HandEyeEstimate(
        mounting=mounting,
        names=labels,
        base_from_flange=base_from_flange,
        camera_from_target=camera_from_target,
        flange_from_held=fit.flange_from_held,
        base_from_fixed=fit.base_from_fixed,
        covariance=np.linalg.inv(fit.information) + fit.small_sample,
        degrees_of_freedom=fit.degrees_of_freedom,
        robot_noise=_robot_noise(fit),
        offsets=smoothed(fit),
        held_out=held_out(poses, fit, held=held),
        scale=scale,
        scale_sigma=scale_sigma,
    )


def target_poses(observations: Sequence[Observations], camera: Camera, *, names: Sequence[str] = ()) -> Rigid:
    """Return camera_from_target (n) of one target in n pictures, each estimated separately and without a guess."""
    labels = tuple(names) or tuple(str(i + 1) for i in range(len(observations)))
    return _seen(tuple(observations), camera, labels)[0].camera_from_target


def _checked(base_from_flange: Rigid, pictures: int, mounting: str, names: Sequence[str]) -> tuple[str, ...]:
    expect_known(mounting, "mounting", MOUNTINGS)
    n = _count(base_from_flange, "base_from_flange")
    labels = tuple(str(name) for name in names) or tuple(str(i + 1) for i in range(n))
    if not n == pictures == len(labels):
        raise BadValue("number of robot poses, pictures, names", (n, pictures, len(labels)), "one number for all")
    if n < LEAST_POSES:
        raise TooFewPoints("hand-eye calibration", n, LEAST_POSES, of="poses with two axes of rotation between them")
    return labels


def _count(poses: Rigid, what: str) -> int:
    if poses.rotation.ndim != 3 or poses.translation.ndim != 2:
        raise BadValue(what, repr(poses), "a batch of n poses, one for each picture")
    return len(poses.rotation)


def _covariances(covariance: Array | None, n: int) -> Array:
    """Return covariances (n, 6, 6), zeros where none is known."""
    given = frozen(np.zeros((6, 6)) if covariance is None else covariance, "covariance", (6, 6), batched=True)
    if given.shape not in ((6, 6), (n, 6, 6)):
        raise BadValue("covariance", f"of shape {given.shape}", f"shape (6, 6) or ({n}, 6, 6)")
    return np.broadcast_to(given, (n, 6, 6))


def _seen(
    observations: tuple[Observations, ...], camera: Camera, names: Sequence[str]
) -> tuple[_CameraData, TwoPoses, Array]:
    """Return the views with their noise, both poses of each, and the degrees of freedom of each pose's fit."""
    for name, o in zip(names, observations, strict=True):
        if len(o) < 4:
            raise TooFewPoints(f"the target's pose in picture {name!r}", len(o), 4)
    views = PaddedViews.of([(o.p_world, o.q) for o in observations])
    both = poses_of_views(camera, views)
    lost = np.flatnonzero(~np.isfinite(both.sum_of_squares[:, 0]))
    if lost.size:
        raise BadValue(
            f"picture {names[lost[0]]!r}",
            "one whose pixels no pose of the target explains",
            "four or more points that do not lie on a line, in the order of their pixels, seen by this camera",
        )
    dof = 2 * views.seen.sum(axis=1) - 6
    first = both.chosen(np.zeros(len(views), dtype=int))
    noise = _noise_px(observations, both.sum_of_squares[:, 0], dof)
    return _CameraData(observations, views, camera, noise, first, np.zeros(len(views), dtype=bool)), both, dof


def _noise_px(observations: Sequence[Observations], squares: Array, dof: Array) -> float:
    stated = {o.sigma_px for o in observations}
    if None not in stated:
        if len(stated) > 1:
            raise BadValue("sigma_px of the pictures", sorted(s for s in stated if s), "one value for all")
        return float(stated.pop() or 0.0)
    return max(float(np.sqrt(squares.sum() / dof.sum())), 1e-6)


def _directed(both: TwoPoses, held: bool) -> Rigid:
    poses = Rigid(both.rotation, both.translation)
    return poses if held else poses.inv


def _poses(base_from_flange: Rigid, seen: _CameraData, held: bool) -> HandEyePoses:
    """Return the poses with the covariance that follows from the pixels."""
    C = seen.camera_from_target
    _, J = pose_jacobian(seen.camera, C.rotation, C.translation, seen.views.p)
    J = (np.nan_to_num(J) * seen.views.seen[..., None, None]).reshape(len(seen.views), -1, 6)
    N = np.swapaxes(J, 1, 2) @ J / seen.noise_px**2
    return _as_held(base_from_flange, C, np.asarray(np.linalg.inv(N)), held)


def _as_held(base_from_flange: Rigid, camera_from_target: Rigid, covariance: Array, held: bool) -> HandEyePoses:
    if held:
        return HandEyePoses(base_from_flange, camera_from_target, covariance)
    Ad = camera_from_target.adjoint()
    return HandEyePoses(base_from_flange, camera_from_target.inv, Ad @ covariance @ np.swapaxes(Ad, 1, 2))


def _prior(camera: Camera | CameraEstimate) -> InternalsPrior:
    if isinstance(camera, Camera) or not any(n in camera.free for n in camera.parameters[6:]):
        return InternalsPrior.fixed()
    if not np.isfinite(camera.noise_px):
        raise BadValue("the camera's estimate", "without a known noise", "one with sigmas, or its camera alone")
    covariance = camera.noise_px**2 * camera.cofactor[6:, 6:]
    return InternalsPrior.of(_internals(camera.camera), covariance)


def _internals(camera: Camera) -> Array:
    return np.concatenate([internals_of(camera.K), list(camera.lens.parameters.values())])


def _camera_of(internals: Array, like: Camera) -> Camera:
    return camera_of(internals[:5], like.size, type(like.lens)(*(float(c) for c in internals[5:])))


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """The adjustment on pixels: its problem and solution, and the poses by picture with the adjusted camera."""

    problem: HandEyePixels
    solution: BlockSolution[HandEyeState]
    seen: _CameraData
    poses: HandEyePoses
    fit: PosesFit

    @property
    def state(self) -> HandEyeState:
        return self.solution.state


def _adjusted(poses: HandEyePoses, fit: PosesFit, seen: _CameraData, prior: InternalsPrior, held: bool) -> _Adjusted:
    n = len(seen.views)
    still = Rigid(np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3)))
    state = HandEyeState(fit.flange_from_held, fit.base_from_fixed, still, _internals(seen.camera))
    for _ in range(_ROUNDS if prior.columns.size else 1):
        sigmas = np.sqrt(fit.variances)
        problem = HandEyePixels(
            seen.views, poses.base_from_flange, held, seen.camera.lens, prior, seen.noise_px, sigmas
        )
        solution = minimise_blocks(problem, state)
        state = solution.state
        if prior.columns.size:
            seen = _seen_again(seen, _camera_of(state.internals, seen.camera))
            poses = _poses(poses.base_from_flange, seen, held)
            fit = _with_internals(problem, state, poses, fit)
        else:
            fit = evaluated(poses, state.flange_from_held, state.base_from_fixed, fit)
    return _Adjusted(problem, solution, seen, poses, fit)


def _seen_again(seen: _CameraData, camera: Camera) -> _CameraData:
    """Return the same views evaluated with an adjusted camera."""
    both = poses_of_views(camera, seen.views)
    R0 = seen.camera_from_target.rotation
    apart = np.linalg.norm(both.rotation - R0[:, None], axis=(2, 3))
    poses = both.chosen(np.argmin(apart, axis=1))
    dof = 2 * seen.views.seen.sum(axis=1) - 6
    noise = _noise_px(seen.observations, both.sum_of_squares.min(axis=1), dof)
    return _CameraData(seen.observations, seen.views, camera, noise, poses, seen.second)


def _with_internals(problem: HandEyePixels, state: HandEyeState, poses: HandEyePoses, fit: PosesFit) -> PosesFit:
    """Return the fit at a state with the robot's noise estimated again, given the uncertainty of the internals.

    Otherwise an error of the focal length, which moves all pictures alike, would be attributed to the robot's noise.
    """
    here = evaluated(poses, state.flange_from_held, state.base_from_fixed, fit)
    inner, information = problem.internals_by_poses(state)
    through = here.jacobian[:, :, 6:]  # derivative of the offset by a twist of held_from_fixed, up to sign
    if not problem.camera_held:
        inner = poses.held_from_fixed.inv.adjoint() @ inner
    D = np.concatenate([here.jacobian, through @ inner], axis=-1)
    prior = np.zeros((D.shape[2],) * 2)
    prior[12:, 12:] = information
    _, _, M = poses.linearised(state.flange_from_held, state.base_from_fixed)
    found = variance_components(here.offsets, D, M, PATTERNS, fit.variances, floor=SMALLEST**2, prior=prior)
    return replace(here, variances=found.variances, variances_covariance=found.covariance, weights=found.weights)


def _from_pixels(done: _Adjusted, mounting: Mounting, names: tuple[str, ...]) -> HandEyeEstimate:
    inner = [f"internal {c}" for c in done.problem.prior.columns]
    shared = [f"{which} {axis}" for which in (WORDS[mounting].held, WORDS[mounting].fixed) for axis in _POSE]
    cofactors = factorise(done.solution.weighted, shared + inner, [f"offset {axis}" for axis in _POSE], names)
    scale, scale_sigma = scale_of_target(done.poses, done.fit)
    state, seen = done.state, done.seen
    squares = np.sum(done.problem.residuals(state) ** 2, axis=(1, 2))
    return HandEyeEstimate(
        mounting=mounting,
        names=names,
        base_from_flange=done.poses.base_from_flange,
        camera_from_target=seen.camera_from_target,
        flange_from_held=state.flange_from_held,
        base_from_fixed=state.base_from_fixed,
        covariance=cofactors.shared[:12, :12] + done.fit.small_sample,
        degrees_of_freedom=done.fit.degrees_of_freedom,
        robot_noise=_robot_noise(done.fit),
        offsets=np.concatenate([state.offset.translation, so3.log(state.offset.rotation)], axis=1),
        held_out=held_out(done.poses, done.fit, held=done.problem.camera_held, views=seen.views, camera=seen.camera),
        scale=scale,
        scale_sigma=scale_sigma,
        noise_px=seen.noise_px,
        residuals_px=np.sqrt(squares / (2 * seen.views.seen.sum(axis=1))),
        second_pose=seen.second,
        camera=seen.camera,
        observations=seen.observations,
    )


def _robot_noise(fit: PosesFit) -> RobotNoise:
    """Return sigmas with their own sigmas; where a variance is zero its sigma is that of the variance, as a bound."""
    sigma = np.sqrt(fit.variances)
    spread = np.sqrt(np.diag(fit.variances_covariance))
    own = np.where(sigma**2 > spread, spread / (2 * sigma), np.sqrt(spread))
    return RobotNoise(float(sigma[0]), float(sigma[1]), float(own[0]), float(own[1]))
