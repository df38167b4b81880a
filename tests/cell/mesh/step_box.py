"""A box as a STEP file (ISO 10303-21, AP214), written from the standard's entities."""

from __future__ import annotations

from itertools import product


class _Writer:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def __call__(self, text: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={text};")
        return f"#{len(self.lines)}"


def step_box(size: tuple[float, float, float], prefix: str = ".MILLI.") -> str:
    """The text of a file with a box from the origin, edges in the unit of `prefix` and metre."""
    w = _Writer()

    def triple(v: tuple[float, ...]) -> str:
        return "(" + ",".join(f"{float(x)!r}" for x in v) + ")"

    def axes(at: tuple[float, ...], z: tuple[float, ...], x: tuple[float, ...]) -> str:
        names = [
            w(f"CARTESIAN_POINT('',{triple(at)})"),
            w(f"DIRECTION('',{triple(z)})"),
            w(f"DIRECTION('',{triple(x)})"),
        ]
        return w(f"AXIS2_PLACEMENT_3D('',{','.join(names)})")

    corners = {bits: tuple(b * s for b, s in zip(bits, size, strict=True)) for bits in product((0, 1), repeat=3)}
    vertex = {}
    for bits, corner in corners.items():
        point = w(f"CARTESIAN_POINT('',{triple(corner)})")
        vertex[bits] = w(f"VERTEX_POINT('',{point})")
    edge: dict[tuple[tuple[int, ...], tuple[int, ...]], str] = {}
    for a in corners:
        for k in range(3):
            if a[k] == 0:
                b = tuple(1 if i == k else x for i, x in enumerate(a))
                point, way = w(f"CARTESIAN_POINT('',{triple(corners[a])})"), tuple(float(i == k) for i in range(3))
                direction = w(f"DIRECTION('',{triple(way)})")
                vector = w(f"VECTOR('',{direction},1.)")
                line = w(f"LINE('',{point},{vector})")
                edge[a, b] = w(f"EDGE_CURVE('',{vertex[a]},{vertex[b]},{line},.T.)")
    faces = []
    for k, side in product(range(3), (0, 1)):
        u, v = (k + 1) % 3, (k + 2) % 3
        loop = [(0, 0), (1, 0), (1, 1), (0, 1)] if side else [(0, 0), (0, 1), (1, 1), (1, 0)]
        ring = [tuple({k: side, u: p, v: q}[i] for i in range(3)) for p, q in loop]
        oriented = []
        for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
            forward = (a, b) in edge
            oriented.append(
                w(f"ORIENTED_EDGE('',*,*,{edge[(a, b) if forward else (b, a)]},{'.T.' if forward else '.F.'})")
            )
        edges = w(f"EDGE_LOOP('',({','.join(oriented)}))")
        bound = w(f"FACE_OUTER_BOUND('',{edges},.T.)")
        z = tuple(float(i == k) * (1 if side else -1) for i in range(3))
        plane = w(f"PLANE('',{axes(corners[ring[0]], z, tuple(float(i == u) for i in range(3)))})")
        faces.append(w(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = w(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = w(f"MANIFOLD_SOLID_BREP('',{shell})")
    length = w(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({prefix},.METRE.))")
    angle = w("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    round_angle = w("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    fuzzy = w(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),{length},'','')")
    context = w(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({fuzzy}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{round_angle}))REPRESENTATION_CONTEXT('',''))"
    )
    origin = axes((0, 0, 0), (0, 0, 1), (1, 0, 0))
    shape = w(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({origin},{solid}),{context})")
    application = w("APPLICATION_CONTEXT('automotive design')")
    product_context = w(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    part = w(f"PRODUCT('box','box','',({product_context}))")
    formation = w(f"PRODUCT_DEFINITION_FORMATION('','',{part})")
    view = w(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = w(f"PRODUCT_DEFINITION('','',{formation},{view})")
    defined = w(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    w(f"SHAPE_DEFINITION_REPRESENTATION({defined},{shape})")
    head = "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    head += "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
    return head + "\n".join(w.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
