"""A tolerance file from a STEP file's own tolerances (`cadcam.cad.pmi`), as far as photos can judge them.

Positions of holes and pins are judged across their axes, diameters by their rims, profiles of plane faces along their
normals. What photos of edges do not show is told in comments, with why: nothing that the drawing asks is dropped
unsaid.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.pmi.bores import Bore, bores_of, length_words
from cadcam.cad.pmi.chains import chains_of
from cadcam.cad.pmi.faces import Curve, StepFace
from cadcam.cad.pmi.stated import Pmi, StatedSize, StatedTolerance
from cadcam.errors import UnknownName
from cadcam.kinds import expect, expect_names
from cadcam.render.view import Scene
from cadcam.verify.tolerances.drawing_distance import ends_of
from cadcam.verify.tolerances.file import quoted, template

_PARALLEL = 1e-6  # of unit vectors
_EQUAL = 1e-6  # of a zone's width, within which it lies equally about the face
_POSITION, _PROFILE = "position", "surface profile"
_FORM = "photos show where edges lie, not the form of what is between them"
_TURN = "its zone is no angle; judge an angle_deg by hand if photos show the turn"
_RUN = "it is measured on a part that turns"
_WHY = {
    **dict.fromkeys(("flatness", "roundness", "cylindricity", "straightness"), _FORM),
    **dict.fromkeys(("angularity", "parallelism", "perpendicularity"), _TURN),
    **dict.fromkeys(("circular runout", "total runout"), _RUN),
}
_ROUND = ("hole", "pin", "rim")  # kinds of bores
_WIDTH = "its zone is a width, no cylinder: a limit with the direction in which that lies has to be written by hand"
_NO_EDGES = "what it is about has no edges in the model"


@dataclass(frozen=True)
class _Entry:
    """A feature as it will be written: a name, its edges, and lines of text, each with a comment.

    Without lines it is the end of a distance only; of a distance `ends` are the two features that it is between.
    """

    name: str
    chains: tuple[int, ...]
    lines: tuple[tuple[str, str], ...] = ()
    ends: tuple[_Entry, ...] = ()

    def within(self, other: _Entry) -> bool:
        """Return whether it is another one, or a piece of its hole: half a cylinder, say."""
        mine, its = set(self.chains), set(other.chains)
        return mine == its or (mine < its and other.name.startswith(_ROUND))


@dataclass
class _Asked:
    """What is asked of one hole or pin."""

    bore: Bore
    positions: list[StatedTolerance] = field(default_factory=list)
    sizes: list[StatedSize] = field(default_factory=list)


def drawing_template(
    scene: Scene, pmi: Pmi, source: str, *, letters: Sequence[str] = (), seen: Collection[int] | None = None
) -> str:
    """Return a tolerance file of what a STEP file states (`cadcam.cad.pmi.read.read_pmi`), with comments on the rest.

    source: the file's name. letters: the system of datums, such as A, B, C; by default the one that most tolerances
    refer to: a tolerance file has one. seen: the feature chains that photos show, if there are photos; features without
    any are left to a comment. Where nothing that is stated can be judged, the file is one to start from. Raises
    `UnknownName` for a system of datums that the file does not have.
    """
    expect(scene, "scene", Scene)
    expect(pmi, "pmi", Pmi)
    drawing = _Drawing(scene, pmi, expect_names(letters, "letters"))
    every, spaced = _assembled([*drawing.bores(), *drawing.planes()], [*drawing.distances()])
    entries = [entry for entry in every if seen is None or not set(seen).isdisjoint(entry.chains)]
    distances = [one for one in spaced if all(end in entries for end in one.ends)]
    entries = [entry for entry in entries if entry.lines or any(entry in one.ends for one in distances)]
    lines = [
        f"# Tolerances that {source} states, for `cadcam verify`: mm and degrees, in the part's own axes.",
        "# Limits are half of a zone's width or diameter. To see which edges have these numbers (chains):",
        f"# cadcam verify {source} --list -o edges.html",
        "k: 2                    # coverage factor of U = k sigma",
        "rule: guard band        # ISO 14253-1; or: simple acceptance",
        *drawing.datum(),
        "features:",
    ]
    if not entries:
        lines = template(scene).splitlines()
    for entry in entries:
        lines += [f"  {quoted(entry.name)}:", *drawing.selected(entry.chains)]
        lines += [_commented(f"    {text}", comment) for text, comment in entry.lines]
    lines += ["distances:"] if distances else []
    for one in distances:
        lines += [f"  {quoted(one.name)}:", f"    between: [{', '.join(quoted(end.name) for end in one.ends)}]"]
        lines += [_commented(f"    {text}", comment) for text, comment in one.lines]
    unseen = [e for e in every if e.lines and e not in entries] + [one for one in spaced if one not in distances]
    beside = [f"{e.name}: not in view" for e in unseen] + drawing.unjudged()
    lines += ["# Stated, but not judged here:"] if beside else []
    return "\n".join([*lines, *(f"#   {said}" for said in beside)]) + "\n"


class _Drawing:
    """What a file states, and the edges of the model that it is about.

    judged: what of it has been written.
    """

    def __init__(self, scene: Scene, pmi: Pmi, letters: Sequence[str]) -> None:
        self.scene, self.pmi = scene, pmi
        systems = Counter(t.datums for t in pmi.tolerances if t.datums)
        if letters and tuple(letters) not in systems:
            raise UnknownName("datum system", " ".join(letters), [" ".join(system) for system in systems])
        self.letters = tuple(letters) or max(systems, key=lambda s: (systems[s], len(s)), default=())
        others = [size.other for size in pmi.sizes if size.other is not None]
        stated = (*pmi.tolerances, *pmi.sizes, *others, *pmi.datums)
        curves = (c for s in stated for c in (*s.curves, *(c for f in s.faces for c in f.curves)))
        self.chain = chains_of(curves, scene.mesh, scene.edges)
        self.judged: set[int] = set()

    def chains(self, curves: Iterable[Curve]) -> tuple[int, ...]:
        """Return the numbers of the feature chains that curves are."""
        return tuple(sorted({self.chain[c.number] for c in curves if c.number in self.chain}))

    def bores(self) -> Iterator[_Entry]:
        """Yield holes and pins with the limits of their position and diameter."""
        found: list[_Asked] = []
        for stated in (*self._here(_POSITION), *(s for s in self.pmi.sizes if s.kind == "diameter")):
            for bore in bores_of(stated):
                asked = next((one for one in found if one.bore.alike(bore)), None)
                if asked is None:
                    found.append(asked := _Asked(bore))
                if isinstance(stated, StatedTolerance):
                    asked.positions += [stated] if stated.diametral else []
                elif isinstance(stated, StatedSize):
                    asked.sizes.append(stated)
        for asked in found:
            chains = self.chains(asked.bore.rims)
            lines = [*self._position(asked), *self._diameter(asked)] if chains else []
            if lines:
                yield _Entry(asked.bore.name, chains, tuple(lines))

    def _position(self, asked: _Asked) -> Iterator[tuple[str, str]]:
        """Yield the lines that limit the place of a hole: the tightest of what is stated to most datums."""
        if asked.positions:
            tightest = min(asked.positions, key=lambda t: (-len(t.datums), t.mm))
            self.judged.add(id(tightest))
            yield f"axis: {_vector(asked.bore.axis)}", f"through {_vector(asked.bore.centre)}"
            yield f"position_mm: {length_words(tightest.mm / 2)}", _words(tightest)

    def _diameter(self, asked: _Asked) -> Iterator[tuple[str, str]]:
        """Yield the line that limits a diameter, from the one of the CAD."""
        for size in asked.sizes:
            low, high = size.limits_mm or (0.0, 0.0)
            if low < high:
                self.judged.add(id(size))
                inside = f"[{length_words(low - 2 * asked.bore.radius)}, {length_words(high - 2 * asked.bore.radius)}]"
                yield (
                    f"diameter_mm: {inside}",
                    f"{length_words(low)} to {length_words(high)} mm" + (f" ({size.fit})" if size.fit else ""),
                )
                return

    def planes(self) -> Iterator[_Entry]:
        """Yield plane faces with the limits of their place along their normal."""
        for tolerance in (*self._here(_PROFILE), *self._here(_POSITION)):
            planes = [face for face in tolerance.faces if face.surface == "plane"]
            for faces in [[face] for face in planes] if tolerance.characteristic == _PROFILE else _slots(planes):
                chains = self.chains(c for face in faces for c in face.curves[: face.outer])
                if chains:
                    self.judged.add(id(tolerance))
                    limit = f"position_mm: {_along_normal(tolerance)}", _words(tolerance)
                    lines = (f"direction: {_vector(faces[0].direction)}", ""), limit
                    yield _Entry(tolerance.name or tolerance.characteristic, chains, lines)

    def distances(self) -> Iterator[_Entry]:
        """Yield distances with limits between holes, pins and faces that are so far apart in the CAD."""
        for size in self.pmi.sizes:
            low, high = size.limits_mm or (0.0, 0.0)
            found, nominal = ends_of(size), size.nominal_mm
            if found is None or nominal is None or not low < high:
                continue
            ends = [_Entry(end.name, self.chains(end.curves)) for end in found[0]]
            if all(end.chains for end in ends):
                self.judged.add(id(size))
                inside = f"[{length_words(low - nominal)}, {length_words(high - nominal)}]"
                way = [(f"direction: {_vector(found[1])}", "")] if found[1] is not None else []
                lines = (f"distance_mm: {inside}", f"{length_words(low)} to {length_words(high)} mm"), *way
                yield _Entry(f"distance {length_words(nominal)} mm", (), lines, tuple(ends))

    def _here(self, characteristic: str) -> Iterator[StatedTolerance]:
        """Yield the tolerances of a kind that refer to the system of datums, or to its first ones."""
        for tolerance in self.pmi.tolerances:
            if tolerance.characteristic == characteristic and self._applies(tolerance):
                yield tolerance

    def _applies(self, tolerance: StatedTolerance) -> bool:
        return bool(tolerance.datums) and tolerance.datums == self.letters[: len(tolerance.datums)]

    def unjudged(self) -> list[str]:
        """Return what is stated and has not been written, each with why."""
        out = [f"{_words(t)}: {self._why(t)}" for t in self.pmi.tolerances if self._left_out(t)]
        sizes = [size for size in self.pmi.sizes if id(size) not in self.judged and size.nominal_mm is not None]
        out += [f"{_size_words(size)}: {_why_not(size)}" for size in sizes]
        return list(dict.fromkeys([*out, *self.pmi.others]))

    def _left_out(self, tolerance: StatedTolerance) -> bool:
        """Return whether a tolerance has not been written, or only for some of its faces."""
        curved = tolerance.characteristic == _PROFILE and any(face.surface != "plane" for face in tolerance.faces)
        return id(tolerance) not in self.judged or curved

    def _why(self, tolerance: StatedTolerance) -> str:
        if tolerance.characteristic not in (_POSITION, _PROFILE):
            return _WHY.get(tolerance.characteristic, "photos do not show it")
        if not tolerance.datums:
            return _FORM
        if not self._applies(tolerance):
            return f"stated to other datums: a file of its own, --datum '{' '.join(tolerance.datums)}'"
        if id(tolerance) in self.judged:
            return "its plane faces alone are judged, not the curved ones"
        if tolerance.characteristic == _POSITION and bores_of(tolerance) and self.chains(_curves(tolerance)):
            tighter = "the tighter one, or the one to more datums, is judged"
            return tighter if tolerance.diametral else _WIDTH
        return _NO_EDGES

    def datum(self) -> list[str]:
        """Return the lines of the datum; none where the edges of one of its letters are not known."""
        if not self.letters:
            return ["# no datum is stated: the pose is fitted to all that is not judged"]
        system, chains = " ".join(self.letters), [self._datum_chains(letter) for letter in self.letters]
        unknown = [letter for letter, some in zip(self.letters, chains, strict=True) if not some]
        if unknown:
            why = f"the file does not say which edges establish {', '.join(unknown)}"
            return [f"# datum {system}: {why}; the pose is fitted to all that is not judged"]
        lines = [
            "datum:",
            f"  # {system}: the pose is fitted to all these edges together, by least squares. An edge of a plane",
            "  # belongs to the face beside it as well: take out what is made less exactly than what is judged.",
            "  # Where photos show too little of it, leave the datum out: then it is all that is not judged.",
        ]
        for letter, some in zip(self.letters, chains, strict=True):
            part, numbers = (line.strip() for line in self.selected(some))
            lines += [_commented(f"  - {part}", letter), f"    {numbers}"]
        return lines

    def _datum_chains(self, letter: str) -> tuple[int, ...]:
        """Return the edges of a datum, or of a common one (A-B): rims of holes, the ways round planes."""
        every = [datum for one in letter.split("-") for datum in self.pmi.datums if datum.letter == one]
        rims = [rim for datum in every for bore in bores_of(datum) for rim in bore.rims]
        around = [c for d in every for f in d.faces if f.surface != "cylinder" for c in f.curves[: f.outer]]
        return self.chains([*rims, *around])

    def selected(self, chains: tuple[int, ...]) -> list[str]:
        """Return the lines that select edges: the name of their part, where all are of one, and their numbers."""
        edges, names = self.scene.edges, self.scene.mesh.part_names
        parts = {names[i] for i in np.unique(edges.part[np.isin(edges.chain, chains)])}
        part = quoted(next(iter(parts))) if len(parts) == 1 else "'*'"
        return [f"    part: {part}", f"    chains: {list(chains)}"]


def _curves(stated: StatedTolerance) -> list[Curve]:
    return [rim for bore in bores_of(stated) for rim in bore.rims]


def _assembled(limited: Sequence[_Entry], distances: Sequence[_Entry]) -> tuple[list[_Entry], list[_Entry]]:
    """Return all features, with the ends of distances among them, and distances between these; all have own names."""
    features = list(limited)
    for end in (end for one in distances for end in one.ends):
        if not any(end.within(feature) for feature in features):
            features.append(end)
    named = _numbered([*features, *distances])
    features, distances = named[: len(features)], named[len(features) :]
    found = [tuple(next(f for f in features if end.within(f)) for end in one.ends) for one in distances]
    return features, [replace(one, ends=ends) for one, ends in zip(distances, found, strict=True)]


def _numbered(entries: Sequence[_Entry]) -> list[_Entry]:
    """Return the entries; those of one name get a number."""
    total, seen, out = Counter(entry.name for entry in entries), Counter[str](), []
    for entry in entries:
        seen[entry.name] += 1
        name = f"{entry.name} no {seen[entry.name]}" if total[entry.name] > 1 else entry.name
        out.append(replace(entry, name=name))
    return out


def _slots(planes: Sequence[StepFace]) -> list[list[StepFace]]:
    """Return the faces of a slot or tongue together; each by itself where they are not parallel."""
    across = [np.linalg.norm(np.cross(face.direction, planes[0].direction)) for face in planes]
    return [list(planes)] if max(across, default=1.0) < _PARALLEL else [[face] for face in planes]


def _along_normal(tolerance: StatedTolerance) -> str:
    """Return half of a zone's width; of one that lies unequally about its face both limits, outward positive."""
    outside = tolerance.mm / 2 if tolerance.outside_mm is None else tolerance.outside_mm
    if abs(outside - tolerance.mm / 2) <= _EQUAL * tolerance.mm:
        return length_words(tolerance.mm / 2)
    return f"[{length_words(outside - tolerance.mm)}, {length_words(outside)}]"


def _why_not(size: StatedSize) -> str:
    if size.limits_mm is None:
        return f"the limits of {size.fit} are not in the file" if size.fit else "without limits"
    if size.other is not None:
        return "it is not between holes, pins or parallel faces that are so far apart in the model"
    return _NO_EDGES if size.kind == "diameter" else "of sizes, diameters alone are judged"


def _words(tolerance: StatedTolerance) -> str:
    """Return a geometric tolerance as a drawing has it, in words."""
    zone = f"{length_words(tolerance.mm)} mm" + (" diameter" if tolerance.diametral else "")
    to = f" to {' '.join(tolerance.datums)}" if tolerance.datums else ""
    more = f", {', '.join(tolerance.modifiers)} (not used)" if tolerance.modifiers else ""
    if tolerance.outside_mm is not None:
        more = f", {length_words(tolerance.outside_mm)} mm of it outside{more}"
    name = f"{tolerance.name}: " if tolerance.name else ""
    return f"{name}{tolerance.characteristic} {zone}{to}{more}"


def _size_words(size: StatedSize) -> str:
    said = (
        "" if size.limits_mm is None else f" ({length_words(size.limits_mm[0])} to {length_words(size.limits_mm[1])})"
    )
    return f"{size.kind} {length_words(size.nominal_mm or 0.0)} mm{said}"


def _vector(v: Array) -> str:
    return f"[{', '.join(length_words(x) for x in v)}]"


def _commented(text: str, comment: str) -> str:
    return f"{text:<36}  # {comment}" if comment else text
