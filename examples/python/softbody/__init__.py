"""Soft-tissue physics for Python: bodies, steps and readings as numpy arrays that share the library's memory.

    import softbody as sb
    mesh = sb.Mesh.organ()
    body = sb.Body(mesh, sb.corotated(8000, 0.45, 1060), gravity=(0, 0, -9.81))
    body.hold(mesh.nodes[:, 1] > 0.05)  # a mask, or indices
    body.step(1 / 60)
    print(body.displacements[:, 2].min())

What is not here by a Python name is in `lib`: every public function of softbody.h, needle.h and register.h, with the types of
`softbody.api`; its documentation is `sb.api.DOCUMENTATION["sb_body_step"]`, or the headers. Units are SI. Without numpy arrays are
sequences of rows.
"""
import ctypes
import os
import sys
from ctypes import byref

from . import api

try:
    import numpy
except ImportError:  # Rows instead
    numpy = None

__all__ = ["Error", "Mesh", "Body", "lib", "api", "check", "linear", "corotated", "stable_neo_hookean", "neo_hookean", "svk"]

_WIDTHS = {
    api.SB_TRI3: 3,
    api.SB_TRI6: 6,
    api.SB_QUAD4: 4,
    api.SB_QUAD8: 8,
    api.SB_QUAD9: 9,
    api.SB_TET4: 4,
    api.SB_TET10: 10,
    api.SB_HEX8: 8,
    api.SB_HEX20: 20,
    api.SB_HEX27: 27,
}
X, Y, Z, XYZ = api.SB_X, api.SB_Y, api.SB_Z, api.SB_XYZ


class Error(Exception):
    """A call that failed: `result` is an sb_result; file, line, node and element as the headers say (-1, 0 or "": none)."""

    def __init__(self, result, error=None):
        name = lib.sb_result_string(result).decode()
        message = error.message.decode("utf-8", "replace") if error is not None else ""
        super().__init__("%s: %s" % (name, message) if message else name)
        self.result = result
        self.file = error.file.decode("utf-8", "replace") if error is not None else ""
        self.line = error.line if error is not None else 0
        self.node = error.node if error is not None else -1
        self.element = error.element if error is not None else -1


def check(result, error=None):
    """Raises Error unless the result of a call of `lib` is SB_OK."""
    if result != api.SB_OK:
        raise Error(result, error)


def _load_library():
    """$SOFTBODY_LIBRARY, or the library beside this file (a wheel's), or the one of `make shared`."""
    here = os.path.dirname(os.path.abspath(__file__))
    name = {"win32": "softbody.dll", "darwin": "libsoftbody.dylib"}.get(sys.platform, "libsoftbody.so")
    tried = [os.environ.get("SOFTBODY_LIBRARY"), os.path.join(here, name)]
    tried.append(os.path.join(here, "..", "..", "..", "build", name))
    for path in tried:
        if path and os.path.exists(path):
            library = ctypes.CDLL(path)
            break
    else:
        raise ImportError("no %s: run `make shared`, or set SOFTBODY_LIBRARY" % name)
    for function, (returned, parameters) in api.FUNCTIONS.items():
        try:
            entry = getattr(library, function)
        except AttributeError:  # left out of this build
            continue
        entry.restype, entry.argtypes = returned, parameters
    return library


lib = _load_library()


class Rows:
    """What stands for an array where numpy is not there: rows as tuples, read when they are asked for."""

    def __init__(self, buffer, width):
        self.buffer, self.width = buffer, width

    def __len__(self):
        return len(self.buffer) // self.width

    def __getitem__(self, i):
        if isinstance(i, slice):
            return [self[k] for k in range(*i.indices(len(self)))]
        if not -len(self) <= i < len(self):
            raise IndexError(i)
        start = i % len(self) * self.width
        return tuple(self.buffer[start : start + self.width])


def _view(pointer, shape, kind, owner):
    """Memory of the library as an array; `owner` lives as long as it does."""
    count = 1
    for length in shape:
        count *= length
    if not pointer or not count:
        return numpy.empty(shape, kind) if numpy else Rows((), shape[1])
    buffer = (kind * count).from_address(ctypes.addressof(pointer.contents))
    buffer.owner = owner
    return numpy.frombuffer(buffer, dtype=kind).reshape(shape) if numpy else Rows(buffer, shape[1])


def _vec3(v):
    return api.sb_vec3(float(v[0]), float(v[1]), float(v[2]))


def _vec3s(rows):
    rows = list(rows)
    return (api.sb_vec3 * len(rows))(*[_vec3(row) for row in rows])


def _indices(nodes):
    """Indices, or a mask, as an int array of C."""
    nodes = list(nodes)
    if nodes and type(nodes[0]).__name__ in ("bool", "bool_"):
        nodes = [i for i, chosen in enumerate(nodes) if chosen]
    return (ctypes.c_int * len(nodes))(*[int(i) for i in nodes])


# ---- materials: Young's modulus (Pa), Poisson's ratio, density (kg/m^3) ----


def linear(young, poisson, density):
    return lib.sb_material_linear(young, poisson, density)


def corotated(young, poisson, density):
    return lib.sb_material_corotated(young, poisson, density)


def stable_neo_hookean(young, poisson, density):
    return lib.sb_material_stable_neo_hookean(young, poisson, density)


def neo_hookean(young, poisson, density):
    return lib.sb_material_neo_hookean(young, poisson, density)


def svk(young, poisson, density):
    return lib.sb_material_svk(young, poisson, density)


class Mesh:
    """Nodes and elements of one type. `raw` is the sb_mesh."""

    def __init__(self):
        self.raw = api.sb_mesh()

    def __del__(self):
        lib.sb_mesh_free(byref(self.raw))

    @classmethod
    def load(cls, path, scale=1.0):
        """From a file of any format that the library reads; 0.001 scales millimetres."""
        options, error, mesh = lib.sb_default_load_options(), api.sb_error(), cls()
        options.scale = scale
        check(lib.sb_mesh_load(byref(mesh.raw), os.fsencode(path), byref(options), byref(error)), error)
        return mesh

    @classmethod
    def organ(cls, cells=12, element=api.SB_TET4):
        """A liver-like organ, `cells` elements along its longest side."""
        error, mesh = api.sb_error(), cls()
        check(lib.sb_mesh_organ(element, cells, None, byref(mesh.raw), byref(error)), error)
        return mesh

    @classmethod
    def beam(cls, cells, size, element=api.SB_TET4):
        """A block of `cells` (three counts) and `size` (three lengths, m), with a corner in the origin."""
        error, mesh = api.sb_error(), cls()
        check(lib.sb_mesh_beam(element, *cells, _vec3(size), None, byref(mesh.raw), byref(error)), error)
        return mesh

    @property
    def nodes(self):
        """(nodes, 3), m."""
        return _view(self.raw.nodes, (self.raw.node_count, 3), ctypes.c_double, self)

    @property
    def elements(self):
        """(elements, nodes of each), indices of nodes."""
        width = _WIDTHS[self.raw.element_type]
        return _view(self.raw.elements, (self.raw.element_count, width), ctypes.c_int, self)

    def save_vtk(self, path, **fields):
        """Writes the mesh with fields by node: arrays of (nodes,) or (nodes, 3)."""
        kept, rows = [], []
        for name, values in fields.items():
            numbers = [float(x) for row in values for x in (row if hasattr(row, "__len__") else [row])]
            array = (ctypes.c_double * len(numbers))(*numbers)
            kept.append(array)
            width = len(numbers) // max(self.raw.node_count, 1)
            rows.append(api.sb_field(name.encode(), api.SB_FIELD_NODES, width, array))
        table = (api.sb_field * max(len(rows), 1))(*rows)
        error = api.sb_error()
        check(lib.sb_mesh_save_vtk(os.fsencode(path), byref(self.raw), table, len(rows), byref(error)), error)


class Body:
    """A mesh with material, supports and loads, stepped in time. `raw` is the sb_body.

    Arrays that it gives share the library's memory: they change with each step, and live as long as the body.
    """

    def __init__(self, mesh, material, gravity=(0, 0, 0), **settings):
        """settings: other fields of sb_body_def, e.g. integrator=api.SB_NEWMARK, tolerance=1e-5."""
        definition, error, self.raw = lib.sb_default_body_def(), api.sb_error(), None
        definition.mesh = ctypes.pointer(mesh.raw)
        definition.material = material
        definition.gravity = _vec3(gravity)
        for name, value in settings.items():
            if not hasattr(definition, name):
                raise TypeError("sb_body_def has no field %s" % name)
            setattr(definition, name, value)
        raw = ctypes.POINTER(api.sb_body)()
        check(lib.sb_body_create(byref(definition), byref(raw), byref(error)), error)
        self.mesh, self.raw = mesh, raw

    def __del__(self):
        if getattr(self, "raw", None):
            lib.sb_body_destroy(self.raw)

    def hold(self, nodes, axes=XYZ):
        """Holds nodes (indices, or a mask) where they are."""
        error, chosen = api.sb_error(), _indices(nodes)
        check(lib.sb_body_hold(self.raw, chosen, len(chosen), axes, byref(error)), error)

    def place(self, nodes, positions, axes=XYZ):
        """The next step takes the nodes to positions (m)."""
        error, chosen, rows = api.sb_error(), _indices(nodes), _vec3s(positions)
        if len(rows) != len(chosen):
            raise ValueError("%d nodes, %d positions" % (len(chosen), len(rows)))
        check(lib.sb_body_place(self.raw, chosen, len(chosen), axes, rows, byref(error)), error)

    def release(self, nodes, axes=XYZ):
        error, chosen = api.sb_error(), _indices(nodes)
        check(lib.sb_body_release(self.raw, chosen, len(chosen), axes, byref(error)), error)

    def step(self, dt):
        """Advances by dt (s) and returns the sb_step_info. A step that fails raises, and the body is as before it."""
        info = api.sb_step_info()
        check(lib.sb_body_step(self.raw, dt, byref(info)), info.error)
        return info

    def solve_static(self):
        """Finds the equilibrium; returns the sb_step_info."""
        info = api.sb_step_info()
        check(lib.sb_body_solve_static(self.raw, None, byref(info)), info.error)
        return info

    def _rows(self, pointer):
        return _view(pointer, (lib.sb_body_node_count(self.raw), 3), ctypes.c_double, self)

    @property
    def positions(self):
        """(nodes, 3), m."""
        return self._rows(lib.sb_body_positions(self.raw))

    @property
    def displacements(self):
        """(nodes, 3), m."""
        return self._rows(lib.sb_body_displacements(self.raw))

    @property
    def velocities(self):
        """(nodes, 3), m/s."""
        return self._rows(lib.sb_body_velocities(self.raw))

    @property
    def reactions(self):
        """(nodes, 3), N: of supports on the body."""
        return self._rows(lib.sb_body_reactions(self.raw))

    def von_mises(self):
        """(nodes,), Pa: new numbers, not the library's memory."""
        values = (ctypes.c_double * lib.sb_body_node_count(self.raw))()
        lib.sb_body_nodal_von_mises(self.raw, values)
        return numpy.frombuffer(values) if numpy else list(values)

    def save(self):
        """The state as bytes: `restore` brings it back to the last bit."""
        size = lib.sb_body_state_size(self.raw)
        moment = ctypes.create_string_buffer(size)
        check(lib.sb_body_state_save(self.raw, moment, size))
        return moment.raw

    def restore(self, moment):
        error = api.sb_error()
        check(lib.sb_body_state_load(self.raw, moment, len(moment), byref(error)), error)

    def hash(self):
        """64 bits of the state: equal for equal runs."""
        return lib.sb_body_state_hash(self.raw)
