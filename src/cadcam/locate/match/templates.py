"""Area-based matching: windows of the part, drawn at its presumed pose, are searched for in the photos.

Each round draws the part at the latest pose, so that windows have the right rotation, scale and perspective; chooses
the salient ones; finds the peaks of each one's correlation near its expected place; and takes the pose that most of
them agree on. An occluded feature finds nothing or something wrong, a repeated one several places: neither counts
unless it agrees with the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Ids, Picture, frozen
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.image.correlate import CorrelateOptions, Peaks, correlate
from cadcam.image.template import Template
from cadcam.kinds import expect, expect_count, expect_each, expect_known, expect_numbers, expect_positive
from cadcam.locate.match.appearance import APPEARANCES, Appearance, counted, of_model, of_photo
from cadcam.locate.match.closeness import edge_closeness
from cadcam.locate.match.consensus import LEAST_AGREEING, PlaceCandidates, consensus, pose_of_matches
from cadcam.locate.match.salient import PLAIN_SALIENT, SalientOptions, Windows, salient_windows
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Renderer

CERTAIN = 1e-2  # expected number of poses by chance below which an agreement is believed
LEAST_SHARE = 1 / 3  # of the features, and of the lines, that must support a pose
_NARROWER = 0.4  # ratio of the reach from round to round
_LEAST_REACH = 8.0  # px


@dataclass(frozen=True, slots=True)
class TemplateOptions:
    """How a part is matched by windows.

    appearance: what is compared. reach: px around its expected place in which a feature is searched for in the first
    round; turn: the largest rotation in the picture, rad. peaks: candidates kept per feature. tolerance: px within
    which features agree on a pose in the first round. rounds: of drawing and matching. salient: how windows are chosen.
    """

    appearance: Appearance = "lines"
    reach: float = 45.0
    turn: float = math.radians(20)
    peaks: int = 4
    least_score: float = 0.3
    tolerance: float = 5.0
    rounds: int = 3
    salient: SalientOptions = PLAIN_SALIENT

    def __post_init__(self) -> None:
        expect_numbers(self)
        expect(self.salient, "salient", SalientOptions)
        expect_known(self.appearance, "appearance", APPEARANCES)
        if not 1 <= self.reach < math.inf:
            raise BadValue("reach", self.reach, "1 px or more")
        if not 0 <= self.turn <= math.pi:
            raise BadValue("turn", self.turn, "rad, from 0 to pi")
        for name, value in (("peaks", self.peaks), ("rounds", self.rounds)):
            expect_count(value, name, expected="a whole number, 1 or more")
        if not 0 < self.least_score <= 1:
            raise BadValue("least_score", self.least_score, "a number above 0, at most 1")
        expect_positive(self.tolerance, "tolerance", "px, a number above 0")


PLAIN_TEMPLATES = TemplateOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """N windows that were searched for: where the drawing has them, and all places in the photo that look like them.

    window (N, 2) px, the window's centre in the drawing; p_part, right (N, 3) mm as in `Windows`; photo (N,); gap (N,)
    to what is near it in the drawing, 1 where not checked; peaks: N tables, in px of the photo; chosen (N,): which peak
    agrees with the pose, -1 for none.
    """

    window: Array
    p_part: Array
    right: Array
    photo: Ids
    gap: Array
    peaks: tuple[Peaks, ...]
    chosen: Ids

    def __post_init__(self) -> None:
        n = len(self.peaks)
        for name, shape in (("window", (n, 2)), ("p_part", (n, 3)), ("right", (n, 3)), ("gap", (n,))):
            object.__setattr__(self, name, frozen(getattr(self, name), f"features' {name}", shape))
        for name in ("photo", "chosen"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"features' {name}", (n,), np.int32))

    def __len__(self) -> int:
        return len(self.peaks)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TemplateMatches(Brief):
    """The matches of a part's windows, and the pose that they give.

    Matches (K): q (K, 2) px, p_part (K, 3) mm, covariance (K, 2, 2) px^2, photo (K,). pose: the one that most features
    agree on, None where not even four do; by_chance: the expected number of equally well supported poses if all peaks
    lay at random; close: the share of the visible lines at that pose that lie on edges of the photo, beyond chance
    (`edge_closeness`). features: those of the last round, with their peak tables.
    """

    q: Array
    p_part: Array
    covariance: Array
    photo: Ids
    pose: PoseEstimate | None
    by_chance: float
    close: float
    features: Features = field(repr=False)

    @property
    def found(self) -> bool:
        """Return whether the pose is believed: chance does not explain it, enough features and lines support it."""
        if self.pose is None or self.by_chance >= CERTAIN:
            return False
        return len(self.q) >= LEAST_SHARE * len(self.features) and self.close >= LEAST_SHARE

    @property
    def sigma(self) -> Array:
        """Return the standard deviation (K,) px of a coordinate, rms of x and y."""
        return np.asarray(np.sqrt(0.5 * np.einsum("nii->n", self.covariance)))


def match_templates(
    part: Part,
    photos: Sequence[Photo],
    start: Rigid,
    *,
    options: TemplateOptions = PLAIN_TEMPLATES,
    rng: np.random.Generator | None = None,
) -> TemplateMatches:
    """Return the matches of a part's windows in photos, and the pose they agree on, from world_from_part `start`.

    rng: draws the triples that are tried; by default with a fixed seed. Raises `MissingCore`.
    """
    expect(part, "part", Part)
    photos = expect_each(photos, "photos", Photo)
    expect_motion(start, "start")
    expect(options, "options", TemplateOptions)
    expect(rng, "rng", np.random.Generator, optional=True)
    if not photos:
        raise BadValue("photos", "none", "at least one photo")
    looks = [of_photo(photo.gray, options.appearance) for photo in photos]
    rng = np.random.default_rng(0) if rng is None else rng
    matching = _Matching(part, photos, looks, open_renderer(part.scene, threads=1), rng)
    done = matching.round(start, options)
    now = options
    for _ in range(options.rounds - 1):
        if done.pose is None or done.by_chance >= CERTAIN:
            break
        now = _narrowed(now)
        again = matching.round(done.pose.world_from_part, now)
        if again.pose is None:
            break
        done = replace(again, by_chance=done.by_chance)  # of the first search: later rounds know where to look
    return done if done.pose is None else replace(done, close=_close(part, photos, done.pose.world_from_part))


def _close(part: Part, photos: Sequence[Photo], pose: Rigid) -> float:
    """Return how close the part's lines at a pose lie to edges, over the lines of all photos together."""
    each = [edge_closeness(p.gray, part.lines.draw(p.camera, p.camera_from_world @ pose)) for p in photos]
    length = np.array([float(c.length.sum()) for c in each])
    return float(np.dot([c.total for c in each], length) / max(float(length.sum()), 1e-9))


def _narrowed(options: TemplateOptions) -> TemplateOptions:
    """Return the options of the next round, which starts from a pose that features agree on."""
    return replace(
        options,
        reach=max(_NARROWER * options.reach, _LEAST_REACH),
        turn=max(_NARROWER * options.turn, math.radians(4)),
        tolerance=max(0.5 * options.tolerance, 2.0),
        salient=replace(options.salient, reach=0.0),  # repetitions are out of reach by now
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Matching:
    """What all rounds of a matching share: part, photos, their appearances (H, W), renderer and random numbers."""

    part: Part
    photos: Sequence[Photo]
    looks: Sequence[Picture]
    renderer: Renderer
    rng: np.random.Generator

    def round(self, pose: Rigid, options: TemplateOptions) -> TemplateMatches:
        """Return the matches of the part drawn at one pose, and the pose that they agree on."""
        windows = [self._windows(photo, pose, options) for photo in self.photos]
        peaks = tuple(
            _peaks(look, template, at, options)
            for look, own in zip(self.looks, windows, strict=True)
            for template, at in zip(own.templates, own.q, strict=True)
        )
        features = Features(
            window=np.concatenate([w.q for w in windows]),
            p_part=np.concatenate([w.p_part for w in windows]),
            right=np.concatenate([w.right for w in windows]),
            photo=np.repeat(np.arange(len(windows)), [len(w) for w in windows]).astype(np.int32),
            gap=np.concatenate([w.gap for w in windows]),
            peaks=peaks,
            chosen=np.full(len(peaks), -1),
        )
        return _agreed(features, self.photos, pose, options, self.rng)

    def _windows(self, photo: Photo, pose: Rigid, options: TemplateOptions) -> Windows:
        """Return the salient windows of the part drawn as one photo should show it."""
        camera_from_part = photo.camera_from_world @ pose
        grey = Look(background=(0.5, 0.5, 0.5))
        view = self.renderer.render(photo.camera, camera_from_part, channels=Channel.IMAGE | Channel.DEPTH, look=grey)
        wireframe = self.part.lines.draw(photo.camera, camera_from_part)
        drawing = of_model(view, wireframe, options.appearance)
        counts = counted(view, drawing, options.appearance)
        return salient_windows(drawing, counts, view, camera_from_part, options=options.salient)


def _peaks(look: Picture, template: Template, at: Array, options: TemplateOptions) -> Peaks:
    """Return the peaks of a window within reach of its expected place, in px of the photo."""
    far = math.ceil(options.reach) + template.size[0] // 2 + 1
    x, y = (int(v) for v in at)
    left, top = max(x - far, 0), max(y - far, 0)
    crop = look[top : max(y + far + 1, 0), left : max(x + far + 1, 0)]
    wanted = CorrelateOptions(
        angles=(-options.turn, options.turn),
        count=options.peaks,
        least_score=options.least_score,
        either_sign=options.appearance == "gray",
    )
    found = correlate(crop, template, options=wanted)
    return replace(found, q=found.q + np.array([left, top]))


def _agreed(
    features: Features, photos: Sequence[Photo], start: Rigid, options: TemplateOptions, rng: np.random.Generator
) -> TemplateMatches:
    """Return the features with the pose that most of them agree on, and which peak of each does."""
    counts = np.array([len(p) for p in features.peaks], int)
    if counts.sum() < LEAST_AGREEING:
        return replace(_nothing(), features=features)
    candidates = _candidates(features, counts, options)
    best = consensus(candidates, photos, start, tolerance=options.tolerance, rng=rng)
    if best is None:
        return replace(_nothing(), features=features)
    of = candidates.feature[best.chosen]
    first = np.cumsum(counts) - counts  # of each feature's candidates
    chosen = np.full(len(features), -1)
    chosen[of] = best.chosen - first[of]
    q, covariance = candidates.q[best.chosen], candidates.covariance[best.chosen]
    p, photo = features.p_part[of], features.photo[of]
    pose = pose_of_matches(photos, photo, p, q, covariance, best.world_from_part)
    return TemplateMatches(q, p, covariance, photo, pose, best.by_chance, 0.0, replace(features, chosen=chosen))


def _candidates(features: Features, counts: npt.NDArray[np.int_], options: TemplateOptions) -> PlaceCandidates:
    """Return the peaks of all features in one list; counts (N,): how many each feature has."""
    return PlaceCandidates(
        feature=np.repeat(np.arange(len(features)), counts).astype(np.int32),
        q=np.concatenate([p.q for p in features.peaks]),
        angle=np.concatenate([p.angle for p in features.peaks]),
        covariance=np.concatenate([p.covariance[:, :2, :2] for p in features.peaks]),
        score=np.abs(np.concatenate([p.score for p in features.peaks])),
        p_part=features.p_part,
        right=features.right,
        photo=features.photo,
        reach=options.reach,
        turn=options.turn,
    )


def _nothing() -> TemplateMatches:
    """Return the result without any match."""
    none = np.zeros((0, 2))
    whole = np.zeros(0, np.int32)
    empty = Features(none, np.zeros((0, 3)), np.zeros((0, 3)), whole, np.zeros(0), (), whole)
    return TemplateMatches(
        none, np.zeros((0, 3)), np.zeros((0, 2, 2)), np.zeros(0, np.int32), None, math.inf, 0.0, empty
    )
