"""A drilled plate as a STEP AP242 file that states its tolerances, written entity by entity.

Plate 120 x 80 x 10 mm, its top at z = 10 is datum A; two holes of 8 mm are B and C; two of 20 mm, one of 12 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

SIZE = (120.0, 80.0, 10.0)
HOLES = {"B": (15.0, 40.0, 4.0), "C": (105.0, 40.0, 4.0), "left": (45.0, 25.0, 10.0), "right": (75.0, 25.0, 10.0)}
HOLES |= {"small": (60.0, 60.0, 6.0)}  # x, y, radius


@dataclass
class StepText:
    """Lines of a data section; each call of `add` returns the reference to a new entity."""

    lines: list[str] = field(default_factory=list)

    def add(self, text: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={text};")
        return f"#{len(self.lines)}"

    def whole(self) -> str:
        head = (
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION(('drilled plate with tolerances'),'2;1');\n"
            "FILE_NAME('drilled_plate.step','2026-11-28T00:00:00',(''),(''),'','','');\n"
            "FILE_SCHEMA(('AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }'));\n"
            "ENDSEC;\nDATA;\n"
        )
        return head + "\n".join(self.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"

    def point(self, *p: float) -> str:
        return self.add(f"CARTESIAN_POINT('',({','.join(map(repr, p))}))")

    def direction(self, *d: float) -> str:
        return self.add(f"DIRECTION('',({','.join(map(repr, d))}))")

    def placement(self, origin: Sequence[float], z: Sequence[float], x: Sequence[float]) -> str:
        parts = self.point(*origin), self.direction(*z), self.direction(*x)
        return self.add(f"AXIS2_PLACEMENT_3D('',{','.join(parts)})")

    def listed(self, keyword: str, items: Sequence[str]) -> str:
        return self.add(f"{keyword}('',({','.join(items)}))")


class DrawnPlate(StepText):
    """The plate's solid and its tolerances; scale: mm that a unit of length has; 25.4 says so in the file."""

    def __init__(self, unit_mm: float = 1.0) -> None:
        super().__init__()
        self.unit_mm = unit_mm
        self._context()
        self.sides: dict[str, str] = {}
        self.halves: dict[str, list[str]] = {}
        self._solid()

    def _length(self, mm: float) -> float:
        return mm / self.unit_mm

    def _context(self) -> None:
        metre = self.add("(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))")
        self.unit = metre
        if self.unit_mm != 1.0:
            value = self.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({self.unit_mm!r}),{metre})")
            exponents = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
            self.unit = self.add(f"(CONVERSION_BASED_UNIT('INCH',{value}) LENGTH_UNIT() NAMED_UNIT({exponents}))")
        angle = self.add("(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.))")
        solid = self.add("(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT())")
        within = self.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),{self.unit},'','')")
        self.context = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({within})) "
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({self.unit},{angle},{solid})) REPRESENTATION_CONTEXT('',''))"
        )
        self.application = self.add("APPLICATION_CONTEXT('managed model based 3d engineering')")
        self.definition, self.shape = self._product("drilled plate")

    def _product(self, name: str) -> tuple[str, str]:
        product_context = self.add(f"PRODUCT_CONTEXT('',{self.application},'mechanical')")
        product = self.add(f"PRODUCT('{name}','{name}','',({product_context}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        definition_context = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{self.application},'design')")
        definition = self.add(f"PRODUCT_DEFINITION('','',{formation},{definition_context})")
        return definition, self.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")

    def _solid(self) -> None:
        x, y, z = map(self._length, SIZE)
        corner = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
        vertex = {(i, h): self._vertex(*corner[i], h) for i in range(4) for h in (0.0, z)}
        along = {(i, h): self._line(vertex[i, h], vertex[(i + 1) % 4, h], *corner[i], h, i) for i, h in vertex}
        up = [self._line(vertex[i, 0.0], vertex[i, z], *corner[i], 0.0, 4) for i in range(4)]
        rims = {(name, h): self._rims(*map(self._length, hole), h) for name, hole in HOLES.items() for h in (0.0, z)}
        faces = []
        for h, sense in ((z, ".T."), (0.0, ".F.")):
            bounds = [self._bound([(along[i, h], sense) for i in (range(4) if h else range(3, -1, -1))], outer=True)]
            back = ".F." if h else ".T."
            bounds += [self._bound([(arc, back) for arc in rims[name, h][0][:: -1 if h else 1]]) for name in HOLES]
            plane = self.add(f"PLANE('',{self.placement((0.0, 0.0, h), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))})")
            faces.append(self.add(f"ADVANCED_FACE('',({','.join(bounds)}),{plane},{sense})"))
            self.sides["top" if h else "bottom"] = faces[-1]
        for i, name in enumerate(("front", "right", "back", "left")):
            j = (i + 1) % 4
            around = [(along[i, 0.0], ".T."), (up[j], ".T."), (along[i, z], ".F."), (up[i], ".F.")]
            out, x_axis = _NORMALS[i], _ALONG[i]
            plane = self.add(f"PLANE('',{self.placement((*corner[i], 0.0), out, x_axis)})")
            faces.append(self.add(f"ADVANCED_FACE('',({self._bound(around, outer=True)}),{plane},.T.)"))
            self.sides[name] = faces[-1]
        for name, hole in HOLES.items():
            self.halves[name] = self._bore(hole, rims[name, 0.0], rims[name, z])
            faces += self.halves[name]
        solid = self.add(f"MANIFOLD_SOLID_BREP('',{self.listed('CLOSED_SHELL', faces)})")
        self.origin = self.placement((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
        self.model = self.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({self.origin},{solid}),{self.context})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION({self.shape},{self.model})")

    def assemble(self, *places: tuple[Sequence[float], Sequence[float], Sequence[float]], turned: bool = False) -> None:
        """Put a plate at each place of an assembly: origin (mm), z and x; turned: which is related to the plate."""
        frames = [self.placement([self._length(v) for v in origin], z, x) for origin, z, x in places]
        definition, shape = self._product("pair of plates")
        whole = self.add(f"SHAPE_REPRESENTATION('',({','.join((self.origin, *frames))}),{self.context})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{whole})")
        for k, frame in enumerate(frames, 1):
            usage = f"'{k}','plate {k}','',{definition},{self.definition},$"
            occurrence = self.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE({usage})")
            of = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{occurrence})")
            items, models = ((a, b)[:: -1 if turned else 1] for a, b in ((self.origin, frame), (self.model, whole)))
            place = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',{','.join(items)})")
            relation = self.add(
                f"(REPRESENTATION_RELATIONSHIP('','',{','.join(models)}) "
                f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION({place}) SHAPE_REPRESENTATION_RELATIONSHIP())"
            )
            self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{of})")

    def _vertex(self, *p: float) -> str:
        return self.add(f"VERTEX_POINT('',{self.point(*p)})")

    def _edge(self, a: str, b: str, curve: str) -> str:
        return self.add(f"EDGE_CURVE('',{a},{b},{curve},.T.)")

    def _line(self, a: str, b: str, x: float, y: float, z: float, way: int) -> str:
        vector = self.add(f"VECTOR('',{self.direction(*_ALONG[way])},1.)")
        return self._edge(a, b, self.add(f"LINE('',{self.point(x, y, z)},{vector})"))

    def _rims(self, x: float, y: float, r: float, h: float) -> tuple[list[str], list[str]]:
        """Return the two arcs of a rim, counter-clockwise from above, and their ends."""
        circle = self.add(f"CIRCLE('',{self.placement((x, y, h), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))},{r!r})")
        east, west = self._vertex(x + r, y, h), self._vertex(x - r, y, h)
        return [self._edge(east, west, circle), self._edge(west, east, circle)], [east, west]

    def _bore(
        self, hole: tuple[float, float, float], low: tuple[list[str], list[str]], high: tuple[list[str], list[str]]
    ) -> list[str]:
        """Return the two halves of a hole's wall."""
        x, y, r = map(self._length, hole)
        seams = [self._line(low[1][k], high[1][k], x + (1 - 2 * k) * r, y, 0.0, 4) for k in (0, 1)]
        wall = f"{self.placement((x, y, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))},{r!r}"
        halves = []
        for k in (0, 1):
            around = [(low[0][k], ".F."), (seams[k], ".T."), (high[0][k], ".T."), (seams[1 - k], ".F.")]
            surface = self.add(f"CYLINDRICAL_SURFACE('',{wall})")
            halves.append(self.add(f"ADVANCED_FACE('',({self._bound(around, outer=True)}),{surface},.F.)"))
        return halves

    def _bound(self, edges: Sequence[tuple[str, str]], *, outer: bool = False) -> str:
        loop = self.listed("EDGE_LOOP", [self.add(f"ORIENTED_EDGE('',*,*,{edge},{sense})") for edge, sense in edges])
        return self.add(f"FACE_{'OUTER_' if outer else ''}BOUND('',{loop},.T.)")

    def mm(self, value: float, name: str = "") -> str:
        """Return a length with its unit, given in mm."""
        return self.add(
            f"(LENGTH_MEASURE_WITH_UNIT() MEASURE_REPRESENTATION_ITEM() "
            f"MEASURE_WITH_UNIT(LENGTH_MEASURE({self._length(value)!r}),{self.unit}) REPRESENTATION_ITEM('{name}'))"
        )

    def aspect(self, *faces: str, keyword: str = "SHAPE_ASPECT", more: str = "") -> str:
        """Return an aspect of the shape that is these faces: directly a single one, else made of one for each."""
        if len(faces) == 1:
            aspect = self.add(f"{keyword}('','',{self.shape},.T.{more})")
            self.add(f"GEOMETRIC_ITEM_SPECIFIC_USAGE('','',{aspect},{self.model},{faces[0]})")
            return aspect
        aspect = self.add(f"{keyword if more else f'COMPOSITE_{keyword}'}('','',{self.shape},.T.{more})")
        for face in faces:
            self.add(f"SHAPE_ASPECT_RELATIONSHIP('','',{aspect},{self.aspect(face)})")
        return aspect

    def datum(self, letter: str, *faces: str) -> str:
        feature = self.add(f"DATUM_FEATURE('Datum {letter}','',{self.shape},.T.)")
        items = f"SET_REPRESENTATION_ITEM(({','.join(faces)}))" if len(faces) > 1 else faces[0]
        self.add(f"ITEM_IDENTIFIED_REPRESENTATION_USAGE('','',{feature},{self.model},{items})")
        datum = self.add(f"DATUM('','',{self.shape},.F.,'{letter}')")
        self.add(f"SHAPE_ASPECT_RELATIONSHIP('','',{feature},{datum})")
        return datum

    def system(self, *datums: str) -> str:
        compartments = [self.add(f"DATUM_REFERENCE_COMPARTMENT('','',{self.shape},.F.,{datum},$)") for datum in datums]
        return self.add(f"DATUM_SYSTEM('','',{self.shape},.F.,({','.join(compartments)}))")

    def tolerance(
        self,
        keyword: str,
        name: str,
        mm: float,
        aspect: str,
        system: str = "",
        *,
        diametral: bool = False,
        more: str = "",
    ) -> str:
        """Return a geometric tolerance; more: further parts of the complex entity."""
        to = f"GEOMETRIC_TOLERANCE_WITH_DATUM_REFERENCE(({system})) " if system else ""
        general = f"GEOMETRIC_TOLERANCE('{name}','',{self.mm(mm)},{aspect})"
        stated = self.add(f"({general} {to}{more} {keyword}_TOLERANCE())")
        if diametral:
            form = self.add("TOLERANCE_ZONE_FORM('cylindrical or circular')")
            self.add(f"TOLERANCE_ZONE('','',{self.shape},.F.,({stated}),{form})")
        return stated

    def size(self, kind: str, nominal: float, low: float, high: float, *faces: str) -> None:
        """State a size with its deviations."""
        dimension = self.add(f"DIMENSIONAL_SIZE({self.aspect(*faces)},'{kind}')")
        self._valued(dimension, nominal)
        limits = self.add(f"TOLERANCE_VALUE({self.mm(low)},{self.mm(high)})")
        self.add(f"PLUS_MINUS_TOLERANCE({limits},{dimension})")

    def fit(self, nominal: float, *faces: str) -> None:
        """State a diameter as H11."""
        dimension = self.add(f"DIMENSIONAL_SIZE({self.aspect(*faces)},'diameter')")
        self._valued(dimension, nominal)
        limits = self.add("LIMITS_AND_FITS('H','hole','11','')")
        self.add(f"PLUS_MINUS_TOLERANCE({limits},{dimension})")

    def distance(self, nominal: float, low: float, high: float, a: str, b: str) -> None:
        dimension = self.add(f"DIMENSIONAL_LOCATION('linear distance','',{self.aspect(a)},{self.aspect(b)})")
        values = self.mm(nominal, "nominal value"), self.mm(high, "upper limit"), self.mm(low, "lower limit")
        self._represented(dimension, values)

    def _valued(self, dimension: str, nominal: float) -> None:
        self._represented(dimension, [self.mm(nominal, "nominal value")])

    def _represented(self, dimension: str, values: Sequence[str]) -> None:
        shown = self.add(f"SHAPE_DIMENSION_REPRESENTATION('',({','.join(values)}),{self.context})")
        self.add(f"DIMENSIONAL_CHARACTERISTIC_REPRESENTATION({dimension},{shown})")


_NORMALS = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
_ALONG = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))


def drawn_plate(unit_mm: float = 1.0) -> str:
    """Return the file with all its statements."""
    return stated_plate(unit_mm).whole()


def stated_plate(unit_mm: float = 1.0) -> DrawnPlate:
    """Return the plate with all its statements."""
    plate = DrawnPlate(unit_mm)
    holes = plate.halves
    a, b, c = plate.datum("A", plate.sides["top"]), plate.datum("B", *holes["B"]), plate.datum("C", *holes["C"])
    to_a, to_abc = plate.system(a), plate.system(a, b, c)
    pair = plate.aspect(*holes["left"], *holes["right"])
    plate.tolerance("POSITION", "pair", 0.4, pair, to_abc, diametral=True)
    material = "GEOMETRIC_TOLERANCE_WITH_MODIFIERS((.MAXIMUM_MATERIAL_REQUIREMENT.))"
    small = plate.aspect(*holes["small"])
    plate.tolerance("POSITION", "small", 0.3, small, to_abc, diametral=True, more=material)
    plate.tolerance("SURFACE_PROFILE", "front", 0.5, plate.aspect(plate.sides["front"]), to_abc)
    unequal = f"UNEQUALLY_DISPOSED_GEOMETRIC_TOLERANCE({plate.mm(0.5)})"
    plate.tolerance("SURFACE_PROFILE", "back", 0.5, plate.aspect(plate.sides["back"]), to_abc, more=unequal)
    plate.tolerance("FLATNESS", "flat", 0.1, plate.aspect(plate.sides["top"]))
    plate.tolerance("PERPENDICULARITY", "upright", 0.2, plate.aspect(*holes["B"]), to_a, diametral=True)
    plate.size("diameter", 20.0, -0.1, 0.1, *holes["left"], *holes["right"])
    plate.size("diameter", 12.0, 0.0, 0.2, *holes["small"])
    plate.fit(8.0, *holes["B"])
    plate.distance(30.0, 29.8, 30.2, holes["left"][0], holes["right"][0])
    plate.add(f"ANGULAR_LOCATION('angle','',{plate.aspect(holes['B'][0])},{plate.aspect(plate.sides['top'])},.EQUAL.)")
    return plate


if __name__ == "__main__":
    print(drawn_plate(), end="")
