#!/usr/bin/env python3
"""Writes what other languages need to call the headers, from the headers themselves.

    src/bindings.py                 from the root: examples/python/softbody/api.py and examples/csharp/Softbody.cs
    src/bindings.py --check         fails when these files are not what the headers say now
    src/bindings.py --sizes         prints a C program that prints the size of every struct

Needs pycparser and a C preprocessor ($CC, default cc). Types and functions are those of a double build.
"""
import os
import re
import subprocess
import sys
import tempfile

from pycparser import c_ast, c_parser

HEADERS = ["softbody.h", "needle.h", "register.h"]
PYTHON, CSHARP = "examples/python/softbody/api.py", "examples/csharp/Softbody.cs"
PUBLIC = re.compile(r"(sb|ndl|reg|SB|NDL|REG)_")
# What the headers take from libc: enough for a parser, and nothing that a parser of plain C trips over.
STUBS = {
    "stddef.h": "typedef unsigned long size_t; typedef long ptrdiff_t;",
    "stdint.h": "typedef unsigned char uint8_t; typedef unsigned short uint16_t; typedef unsigned int uint32_t;"
    "typedef unsigned long uint64_t; typedef int int32_t; typedef long int64_t; typedef unsigned long uintptr_t;",
    "stdio.h": "typedef struct FILE FILE;",
    "math.h": "",
    "stdlib.h": "",
    "string.h": "",
}
# C's numbers: ctypes' name, C#'s name.
NUMBERS = {
    "int": ("c_int", "int"),
    "unsigned": ("c_uint", "uint"),
    "unsigned int": ("c_uint", "uint"),
    "float": ("c_float", "float"),
    "double": ("c_double", "double"),
    "char": ("c_char", "byte"),
    "unsigned char": ("c_ubyte", "byte"),
    "size_t": ("c_size_t", "UIntPtr"),
    "uint8_t": ("c_uint8", "byte"),
    "uint16_t": ("c_uint16", "ushort"),
    "uint32_t": ("c_uint32", "uint"),
    "uint64_t": ("c_uint64", "ulong"),
    "int32_t": ("c_int32", "int"),
    "int64_t": ("c_int64", "long"),
    "uintptr_t": ("c_size_t", "UIntPtr"),
}
CSHARP_WORDS = {"base", "fixed", "object", "params", "ref", "out", "in", "string", "event", "lock", "is", "operator", "internal"}


class Api:
    """Public constants, enums, structs and functions, in the order of the headers."""

    def __init__(self, root):
        self.constants = {}  # name -> value
        self.enums = {}  # type -> names of its constants
        self.structs = {}  # type -> [(field, node)], None: opaque
        self.aliases = {}  # other typedefs -> node
        self.functions = []  # (name, return node, [(parameter, node)])
        self.comments = comments_of(root)
        tree = c_parser.CParser().parse(preprocessed(root))
        for item in tree.ext:
            if isinstance(item, c_ast.Typedef):
                self.add_type(item)
            elif isinstance(item, c_ast.Decl):
                self.add_declaration(item)

    def add_type(self, item):
        kind = item.type.type if isinstance(item.type, c_ast.TypeDecl) else None
        if isinstance(kind, c_ast.Enum):
            self.enums[item.name] = self.add_constants(kind)
        elif isinstance(kind, c_ast.Struct):
            fields = None if kind.decls is None else [(d.name, d.type) for d in kind.decls]
            if fields is not None or item.name not in self.structs:
                self.structs[item.name] = fields
        elif item.name not in NUMBERS:
            self.aliases[item.name] = item.type

    def add_declaration(self, item):
        if isinstance(item.type, c_ast.Enum):
            self.add_constants(item.type)
        elif isinstance(item.type, c_ast.FuncDecl) and PUBLIC.match(item.name):
            given = item.type.args.params if item.type.args else []
            parameters = [(p.name, p.type) for p in given if not is_void(p.type)]
            self.functions.append((item.name, item.type.type, parameters))

    def add_constants(self, enum):
        value, names = -1, []
        for member in enum.values.enumerators if enum.values else []:
            value = value + 1 if member.value is None else self.evaluate(member.value)
            self.constants[member.name] = value
            names.append(member.name)
        return names

    def evaluate(self, node):
        if isinstance(node, c_ast.Constant):
            return int(node.value.rstrip("uUlL"), 0)
        if isinstance(node, c_ast.ID):
            return self.constants[node.name]
        if isinstance(node, c_ast.Cast):
            return self.evaluate(node.expr)
        if isinstance(node, c_ast.UnaryOp) and node.op in "+-~":
            return {"+": 1, "-": -1, "~": -1}[node.op] * self.evaluate(node.expr) - (node.op == "~")
        if isinstance(node, c_ast.BinaryOp):
            a, b = self.evaluate(node.left), self.evaluate(node.right)
            return {"+": a + b, "-": a - b, "*": a * b, "|": a | b, "<<": a << b if b >= 0 else 0}[node.op]
        raise ValueError("constant of a kind that is not known here: %s" % node)

    def resolve(self, node):
        """The type behind names that stand for another one: sb_real is a double, callbacks are pointers."""
        while isinstance(node, c_ast.TypeDecl) and isinstance(node.type, c_ast.IdentifierType):
            name = " ".join(node.type.names)
            if name not in self.aliases:
                break
            node = self.aliases[name]
        return node

    def name_of(self, node):
        """Name of a plain type: 'double', 'sb_mesh'; None of pointers, arrays and functions."""
        if not isinstance(node, c_ast.TypeDecl):
            return None
        return " ".join(node.type.names) if isinstance(node.type, c_ast.IdentifierType) else node.type.name

    def is_known(self, node):
        name = self.name_of(node)
        return name is None or name in NUMBERS or name in self.enums or (name in self.structs and PUBLIC.match(name))


def is_void(node):
    return isinstance(node, c_ast.TypeDecl) and getattr(node.type, "names", None) == ["void"]


def is_char(api, node):
    return api.name_of(api.resolve(node)) == "char"


def preprocessed(root):
    with tempfile.TemporaryDirectory() as folder:
        for name, text in STUBS.items():
            guard = "STUB_" + name.replace(".", "_")
            with open(os.path.join(folder, name), "w") as stub:
                stub.write("#ifndef %s\n#define %s\n%s\n#endif\n" % (guard, guard, text))
        command = os.environ.get("CC", "cc").split() + ["-std=c99", "-E", "-P", "-nostdinc", "-U__GNUC__"]
        command += ["-D__attribute__(x)=", "-D__restrict=", "-I" + folder, "-I" + root, "-x", "c", "-"]
        source = "".join('#include "%s"\n' % name for name in HEADERS)
        return subprocess.run(command, input=source, stdout=subprocess.PIPE, check=True, text=True).stdout


def comments_of(root):
    """The comment that ends on the line before each public function."""
    found = {}
    pattern = re.compile(r"/\*((?:[^*]|\*(?!/))*)\*/\n(?:SB|NDL|REG)_API\s[^;(]*?\b(\w+)\s*\(", re.S)
    for name in HEADERS:
        with open(os.path.join(root, name), encoding="utf-8") as header:
            for comment, function in pattern.findall(header.read()):
                lines = [re.sub(r"^\s*\* ?", "", line).rstrip() for line in comment.strip().split("\n")]
                found[function] = "\n".join(lines).strip()
    return found


# ---- Python ----


def python_type(api, node):
    node = api.resolve(node)
    if isinstance(node, c_ast.ArrayDecl):
        return "%s * %d" % (python_type(api, node.type), api.evaluate(node.dim))
    if isinstance(node, c_ast.PtrDecl):
        inner = api.resolve(node.type)
        if isinstance(inner, c_ast.FuncDecl):
            parameters = [p.type for p in inner.args.params if not is_void(p.type)] if inner.args else []
            return "CFUNCTYPE(%s)" % ", ".join(python_type(api, t) for t in [inner.type] + parameters)
        if is_void(inner):
            return "c_void_p"
        if is_char(api, inner):
            return "c_char_p"
        if not api.is_known(inner):
            return "c_void_p"  # a FILE
        return "POINTER(%s)" % python_type(api, inner)
    if is_void(node):
        return "None"
    name = api.name_of(node)
    if name in api.enums:
        return "c_int"
    return NUMBERS[name][0] if name in NUMBERS else name


def python_parameter(api, node):
    """Arrays as parameters are pointers."""
    node = api.resolve(node)
    if isinstance(node, c_ast.ArrayDecl):
        return "POINTER(%s)" % python_type(api, node.type)
    return python_type(api, node)


def python_text(api):
    out = ['"""All of softbody.h, needle.h and register.h for ctypes. Written by src/bindings.py: do not edit."""']
    out += ["from ctypes import *", "", "# fmt: off"]
    for name, value in api.constants.items():
        if PUBLIC.match(name):
            out.append("%s = %d" % (name, value))
    public = [name for name in api.structs if PUBLIC.match(name)]
    out += [""] + ["class %s(Structure): pass" % name for name in public] + [""]
    for name in public:
        fields = api.structs[name]
        if fields is not None:
            out.append("%s._fields_ = [" % name)
            out += ['    ("%s", %s),' % (field, python_type(api, node)) for field, node in fields]
            out.append("]")
    out += ["", "", "FUNCTIONS = {  # name: (what it returns, parameters)"]
    for name, returned, parameters in api.functions:
        types = "".join(python_parameter(api, node) + ", " for _, node in parameters)
        out.append('    "%s": (%s, (%s)),' % (name, python_type(api, returned), types))
    out += ["}", "", "DOCUMENTATION = {"]
    for name, _, _ in api.functions:
        if name in api.comments:
            out.append("    %r: %r," % (name, api.comments[name]))
    out += ["}", ""]
    return "\n".join(out)


# ---- C# ----


def csharp_name(name):
    return "@" + name if name in CSHARP_WORDS else name


def csharp_type(api, node):
    node = api.resolve(node)
    if isinstance(node, (c_ast.PtrDecl, c_ast.ArrayDecl)):
        inner = api.resolve(node.type)
        if isinstance(inner, (c_ast.FuncDecl, c_ast.ArrayDecl)):
            return "IntPtr"
        if is_void(inner):
            return "void*"
        if not api.is_known(inner):
            return "IntPtr"
        return csharp_type(api, inner) + "*"
    if is_void(node):
        return "void"
    name = api.name_of(node)
    return NUMBERS[name][1] if name in NUMBERS else name


def csharp_field(api, name, node):
    """A field; arrays of numbers are fixed buffers, other arrays a field for each entry."""
    node, length = api.resolve(node), 1
    is_array = isinstance(node, c_ast.ArrayDecl)
    while isinstance(node, c_ast.ArrayDecl):
        length *= api.evaluate(node.dim)
        node = api.resolve(node.type)
    kind = csharp_type(api, node)
    if not is_array:
        return ["public %s %s;" % (kind, csharp_name(name))]
    if kind in ("double", "float", "int", "uint", "byte", "ushort", "ulong", "long"):
        return ["public fixed %s %s[%d];" % (kind, csharp_name(name), length)]
    return ["public %s %s;" % (kind, ", ".join("%s_%d" % (name, i) for i in range(length)))]


def summary(text):
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    lines = ["/// " + line for line in escaped.split("\n")]
    return ["    /// <summary>"] + ["    " + line.rstrip() for line in lines] + ["    /// </summary>"]


def csharp_text(api):
    out = ["// All of softbody.h, needle.h and register.h for C#. Written by src/bindings.py: do not edit."]
    out += ["#pragma warning disable CS8981", "using System;", "using System.Runtime.InteropServices;", ""]
    out += ["namespace Softbody", "{"]
    for name, members in api.enums.items():
        if PUBLIC.match(name):
            out.append("public enum %s" % name)
            out += ["{"] + ["    %s = %d," % (m, api.constants[m]) for m in members] + ["}"]
    for name, fields in api.structs.items():
        if not PUBLIC.match(name):
            continue
        if fields is None:  # an object of the library: only pointers to it are met
            out.append("public struct %s { }" % name)
            continue
        out += ["[StructLayout(LayoutKind.Sequential)]", "public unsafe struct %s" % name, "{"]
        for field, node in fields:
            out += ["    " + line for line in csharp_field(api, field, node)]
        out.append("}")
    in_enums = {m for members in api.enums.values() for m in members}
    out += ["public static unsafe class Native", "{", '    public const string Library = "softbody";']
    for name, value in api.constants.items():
        if PUBLIC.match(name) and name not in in_enums:
            kind = "int" if value < 2**31 else "uint"
            out.append("    public const %s %s = %d;" % (kind, name, value))
    for name, returned, parameters in api.functions:
        if name in api.comments:
            out += summary(api.comments[name])
        given = ", ".join("%s %s" % (csharp_type(api, node), csharp_name(p)) for p, node in parameters)
        out.append("    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]")
        out.append("    public static extern %s %s(%s);" % (csharp_type(api, returned), name, given))
    out += ["}", "}", ""]
    return "\n".join(out)


def sizes_text(api):
    lines = ['#include "%s"' % name for name in HEADERS] + ["#include <stdio.h>", "int main(void)", "{"]
    lines += ['    printf("%s %%u\\n", (unsigned)sizeof(%s));' % (n, n) for n, f in api.structs.items() if f and PUBLIC.match(n)]
    return "\n".join(lines + ["    return 0;", "}", ""])


def main():
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    api = Api(root)
    if "--sizes" in sys.argv[1:]:
        sys.stdout.write(sizes_text(api))
        return 0
    stale = 0
    for path, text in ((PYTHON, python_text(api)), (CSHARP, csharp_text(api))):
        full = os.path.join(root, path)
        old = open(full, encoding="utf-8").read() if os.path.exists(full) else None
        if old == text:
            continue
        if "--check" in sys.argv[1:]:
            print("%s is not what the headers say: make bindings" % path)
            stale = 1
            continue
        os.makedirs(os.path.dirname(full), exist_ok=True)
        with open(full, "w", encoding="utf-8") as out:
            out.write(text)
    return stale


if __name__ == "__main__":
    sys.exit(main())
