"""Type checker and interpreter for the structured text in deploy/plc. The parser is blark.

The rules are stricter than those of CODESYS: no implicit conversion, no overflow, no undeclared name.
So a program that passes also fits TIA Portal, which converts less by itself.
"""

import copy
import functools
import re

from blark import transform as t
from blark.parse import new_parser, parse_source_code

INTS = {"INT": (-32768, 32767), "UINT": (0, 65535), "UDINT": (0, 4294967295), "DINT": (-(2**31), 2**31 - 1),
        "USINT": (0, 255)}
ELEMENTARY = {"BOOL": False, "BYTE": 0, "WORD": 0, "REAL": 0.0, "TIME": 0, **dict.fromkeys(INTS, 0)}
CONVERSIONS = {
    ("WORD", "UINT"): lambda v: v,
    ("WORD", "INT"): lambda v: v - 65536 if v > 32767 else v,
    ("UINT", "WORD"): lambda v: v,
    ("INT", "WORD"): lambda v: v & 65535,
    ("UINT", "UDINT"): lambda v: v,
    ("INT", "REAL"): float,
    ("REAL", "INT"): round,
    ("REAL", "UINT"): round,
    ("UINT", "STRING"): str,
    ("INT", "STRING"): str,
    ("STRING", "UINT"): int,
}
KEYWORDS = {"on", "step", "action", "link", "en", "eno", "task", "program", "type"}


def is_text(type_):
    return isinstance(type_, tuple) and type_[0] == "string"


class StError(Exception):
    """A mistake in a checked source, or a wrong result of a test."""


@functools.cache
def parser():
    return new_parser()


def parse(path, text):
    """Returns the declarations of a source."""
    result = parse_source_code(text, fn=path, parser=parser())
    if result.exception is not None:
        raise StError(f"{path}: {str(result.exception).splitlines()[0]}")
    return result.transform().items


class Block:
    """A function block or program: its variables by lower-case name, and its compiled body."""

    def __init__(self, name):
        self.name, self.vars, self.body = name, {}, None


class Var:
    def __init__(self, kind, type_, init):
        self.kind, self.type, self.init = kind, type_, init


class Project:
    def __init__(self):
        self.structs, self.aliases, self.blocks, self.globals = {}, {}, {}, {}
        self.now = 0
        ton = Block("TON")
        ton.vars = {
            "in": Var("in", "BOOL", None), "pt": Var("in", "TIME", None), "q": Var("out", "BOOL", None),
            "et": Var("out", "TIME", None), "since": Var("var", "UDINT", None), "runs": Var("var", "BOOL", None),
        }
        ton.body = self.run_ton
        self.blocks["ton"] = ton
        self.pending = []

    def run_ton(self, f):
        if not f["in"]:
            f["runs"], f["q"], f["et"] = False, False, 0
        else:
            if not f["runs"]:
                f["runs"], f["since"] = True, self.now
            f["et"] = min(self.now - f["since"], f["pt"])
            f["q"] = f["et"] >= f["pt"]

    # Declarations ----------------------------------------------------------------------------------------------

    def add(self, path, items):
        for item in items:
            if isinstance(item, t.DataTypeDeclaration):
                self.add_type(path, item.declaration)
            elif isinstance(item, (t.FunctionBlock, t.Program)):
                self.pending.append((path, item))
                self.blocks[item.name.lower()] = Block(str(item.name))
            else:
                raise StError(f"{path}: {type(item).__name__} is not supported here")

    def add_type(self, path, d):
        if isinstance(d, t.StructureTypeDeclaration):
            fields = {}
            for e in d.declarations:
                for v in e.variables:
                    name = v.variable.name.lower()
                    if name in fields:
                        raise StError(f"{path}: field {name} is declared twice")
                    fields[name] = e.init
            self.structs[d.name.lower()] = fields
        elif isinstance(d, t.ArrayTypeDeclaration):
            self.aliases[d.name.lower()] = d.init
        else:
            raise StError(f"{path}: {type(d).__name__} is not supported here")

    def link(self):
        """Resolves all types, then compiles all bodies."""
        for fields in self.structs.values():
            for name, init in fields.items():
                if not isinstance(init, (str, tuple)):
                    fields[name] = self.type_of(init)
        for path, item in self.pending:
            self.declare(path, item, self.blocks[item.name.lower()])
        for path, item in self.pending:
            Compiler(self, path, self.blocks[item.name.lower()]).compile(item)
        self.pending = []

    def declare(self, path, item, block):
        kinds = {"VAR_INPUT": "in", "VAR_OUTPUT": "out", "VAR_IN_OUT": "inout"}
        for group in item.declarations:
            for d in group.items:
                for v in d.variables:
                    token = getattr(v, "variable", v)
                    name = str(getattr(token, "name", token)).lower()
                    if name in block.vars or name in KEYWORDS:
                        raise StError(f"{path}: {name} is declared twice, or is a keyword")
                    type_ = self.type_of(d.init if hasattr(d, "init") and d.init is not None else d.spec)
                    block.vars[name] = Var(kinds.get(group.block_header, "var"), type_, getattr(d.init, "value", None))

    def type_of(self, node):
        if isinstance(node, t.ArrayTypeInitialization):
            sub = node.spec.subranges[0]
            return ("array", int(str(sub.start.value)), int(str(sub.stop.value)), self.type_of(node.spec.type))
        for attr in ("spec", "type", "type_name", "name"):
            if isinstance(node, t.StringTypeSpecification):
                return ("string", int(str(node.length.length.expr.value)) if node.length else 80)
            if hasattr(node, attr) and not isinstance(node, str):
                node = getattr(node, attr)
        name = str(node).lower()
        if name.upper() in ELEMENTARY:
            return name.upper()
        if name in self.aliases:
            return self.type_of(self.aliases[name])
        if name in self.structs:
            return ("struct", name)
        if name in self.blocks:
            return ("fb", name)
        raise StError(f"type {node} is unknown")

    def new(self, type_):
        if isinstance(type_, str):
            return ELEMENTARY[type_]
        if type_[0] == "array":
            return [self.new(type_[3]) for _ in range(type_[1], type_[2] + 1)]
        if type_[0] == "string":
            return ""
        if type_[0] == "struct":
            return {n: self.new(x) for n, x in self.structs[type_[1]].items()}
        block = self.blocks[type_[1]]
        frame = {"": block}
        for name, var in block.vars.items():
            frame[name] = None if var.kind == "inout" else self.new(var.type)
            if var.init is not None:
                _, value = Compiler(self, block.name, block).expr(var.init, var.type)
                frame[name] = value(frame)
        return frame

    def run(self, frame, **inputs):
        for name, value in inputs.items():
            if name.lower() not in frame:
                raise StError(f"{frame[''].name} has no {name}")
            frame[name.lower()] = value
        frame[""].body(frame)


class Compiler:
    """Turns the statements of one block into Python functions, and checks every type."""

    def __init__(self, project, path, block):
        self.p, self.path, self.block = project, path, block

    def fail(self, node, text):
        meta = getattr(node, "meta", None)
        raise StError(f"{self.path}:{getattr(meta, 'line', '?')}: {text}")

    def compile(self, item):
        self.block.body = self.statements(item.body)

    def statements(self, body):
        steps = [self.statement(s) for s in (body.statements if body else [])]

        def run(f):
            for s in steps:
                s(f)

        return run

    def condition(self, node):
        type_, value = self.expr(node)
        if type_ != "BOOL":
            self.fail(node, f"a condition is BOOL, not {type_}")
        return value

    def statement(self, s):
        if isinstance(s, t.AssignmentStatement):
            if len(s.variables) != 1:
                self.fail(s, "one assignment a statement")
            return self.assign(s, s.variables[0], s.expression)
        if isinstance(s, t.IfStatement):
            arms = [(self.condition(s.if_expression), self.statements(s.statements))]
            arms += [(self.condition(e.if_expression), self.statements(e.statements)) for e in s.else_ifs]
            other = self.statements(s.else_clause.statements) if s.else_clause else lambda f: None

            def run_if(f):
                for test, body in arms:
                    if test(f):
                        return body(f)
                return other(f)

            return run_if
        if isinstance(s, t.CaseStatement):
            type_, value = self.expr(s.expression)
            if type_ not in INTS:
                self.fail(s, f"CASE needs an integer, not {type_}")
            arms = {}
            for case in s.cases:
                body = self.statements(case.statements)
                for m in case.matches:
                    key = int(str(m.value))
                    if key in arms:
                        self.fail(s, f"CASE has {key} twice")
                    arms[key] = body
            other = self.statements(s.else_clause.statements) if s.else_clause else lambda f: None
            return lambda f: arms.get(value(f), other)(f)
        if isinstance(s, t.FunctionCallStatement):
            return self.call(s)
        self.fail(s, f"{type(s).__name__} is not supported here")

    def assign(self, node, target, source):
        type_, _, write = self.place(target)
        root = target.name.name if isinstance(target, t.MultiElementVariable) else target.name
        var = self.block.vars.get(str(root).lower())
        if var is not None and var.kind == "in":
            self.fail(node, f"input {root} is written")
        _, value = self.expr(source, type_)
        return lambda f: write(f, value(f))

    def call(self, s):
        type_, read, _ = self.place(s.name)
        if not (isinstance(type_, tuple) and type_[0] == "fb"):
            self.fail(s, f"{s.name} is not a function block")
        block = self.p.blocks[type_[1]]
        moves, given = [], set()
        for a in s.parameters:
            name = str(a.name.name if hasattr(a.name, "name") else a.name).lower()
            var = block.vars.get(name)
            if var is None or var.kind not in ("in", "inout") or name in given:
                self.fail(s, f"{block.name} has no input {name}, or it is given twice")
            given.add(name)
            if var.kind == "inout":
                have, get, _ = self.place(a.value)
                if have != var.type:
                    self.fail(s, f"{name} is {var.type}, not {have}")
                moves.append((name, get))
            else:
                _, get = self.expr(a.value, var.type)
                moves.append((name, lambda f, get=get: copy.deepcopy(get(f))))
        missing = {n for n, v in block.vars.items() if v.kind == "inout"} - given
        if missing:
            self.fail(s, f"{block.name} lacks {missing}")

        def run(f):
            frame = read(f)
            for name, get in moves:
                frame[name] = get(f)
            frame[""].body(frame)

        return run

    def place(self, node):
        """Returns type, reader and writer of a variable."""
        root = node.name if isinstance(node, t.MultiElementVariable) else node
        if not isinstance(root, t.SimpleVariable):
            self.fail(node, f"{node} is not a variable")
        name = str(root.name).lower()
        if name in self.block.vars:
            type_ = self.block.vars[name].type
            owner, key = (lambda f: f), (lambda f: name)
        elif name in self.p.globals:
            type_ = self.p.globals[name][0]
            owner, key = (lambda f: self.p.globals[name]), (lambda f: 1)
        else:
            self.fail(node, f"{root.name} is not declared")
        for e in getattr(node, "elements", []):
            outer, outer_key = owner, key
            owner = lambda f, o=outer, k=outer_key: o(f)[k(f)]
            if isinstance(e, t.FieldSelector):
                field = str(e.field.name).lower()
                if isinstance(type_, tuple) and type_[0] == "struct" and field in self.p.structs[type_[1]]:
                    type_ = self.p.structs[type_[1]][field]
                elif isinstance(type_, tuple) and type_[0] == "fb" and field in self.p.blocks[type_[1]].vars:
                    type_ = self.p.blocks[type_[1]].vars[field].type
                else:
                    self.fail(node, f"{type_} has no {field}")
                key = lambda f, field=field: field
            else:
                if not (isinstance(type_, tuple) and type_[0] == "array"):
                    self.fail(node, f"{type_} is not an array")
                index_type, index = self.expr(e.subscripts[0])
                if index_type != "literal":
                    self.fail(node, "only constant subscripts are supported here")
                low, high, number = type_[1], type_[2], index(None)
                if not low <= number <= high:
                    self.fail(node, f"subscript {number} is not within {low}..{high}")
                type_ = type_[3]
                key = lambda f, n=number - low: n

        def read(f):
            return owner(f)[key(f)]

        def write(f, value):
            old = owner(f)[key(f)]
            if isinstance(old, dict):
                old.update(copy.deepcopy(value))
            elif isinstance(old, list):
                old[:] = value
            else:
                if type_ in INTS and not INTS[type_][0] <= value <= INTS[type_][1]:
                    self.fail(node, f"{value} does not fit into {type_}")
                if isinstance(type_, tuple) and type_[0] == "string" and len(value) > type_[1]:
                    self.fail(node, f"text of {len(value)} bytes does not fit into STRING({type_[1]})")
                owner(f)[key(f)] = value

        return type_, read, write

    def expr(self, node, want=None):
        type_, value = self.typed(node)
        if want is not None and type_ != want:
            number = value(None) if type_ == "literal" else None
            limits = (0, 255) if want == "BYTE" else INTS.get(want) if isinstance(want, str) else None
            fits = number is not None and limits is not None and limits[0] <= number <= limits[1]
            if not fits and not (is_text(want) and is_text(type_)):
                self.fail(node, f"{want} is needed, not {type_} {number if number is not None else ''}")
        return type_, value

    def typed(self, node):
        if isinstance(node, t.ParenthesizedExpression):
            return self.typed(node.expr)
        if isinstance(node, t.Boolean):
            flag = str(node.value).upper() == "TRUE"
            return "BOOL", lambda f: flag
        if isinstance(node, t.Duration):
            unit = {"days": 86400000, "hours": 3600000, "minutes": 60000, "seconds": 1000, "milliseconds": 1}
            ms = sum(int(str(getattr(node, n))) * u for n, u in unit.items() if getattr(node, n))
            return "TIME", lambda f: ms
        if isinstance(node, t.Real):
            real = float(str(node.value))
            return "REAL", lambda f: real
        if isinstance(node, t.String):
            names = {"$R": "\r", "$N": "\n", "$$": "$", "$'": "'"}
            text = re.sub(r"\$.", lambda m: names[m.group().upper()], str(node.value)[1:-1])
            return ("string", len(text)), lambda f: text
        if isinstance(node, (t.Integer, t.BitString)):
            number = int(str(node.value).replace("_", ""), node.base)
            name = "literal" if node.type_name is None else str(node.type_name).upper()
            return name, lambda f: number
        if isinstance(node, t.UnaryOperation):
            type_, value = self.typed(node.expr)
            op = str(node.op).upper()
            if op == "NOT" and type_ == "BOOL":
                return "BOOL", lambda f: not value(f)
            if op == "-" and type_ in ("literal", "REAL", "INT", "DINT"):
                return type_, lambda f: -value(f)
            self.fail(node, f"{op} does not fit {type_}")
        if isinstance(node, t.BinaryOperation):
            return self.binary(node)
        if isinstance(node, t.FunctionCall):
            return self.function(node)
        type_, read, _ = self.place(node)
        return type_, read

    def binary(self, node):
        (lt, left), (rt, right), op = self.typed(node.left), self.typed(node.right), str(node.op).upper()
        kind = lt if lt != "literal" else rt
        if lt == "literal" and rt == "literal":
            self.fail(node, "both operands are literals")
        for side, have in ((node.left, lt), (node.right, rt)):
            if have == "literal":
                self.expr(side, kind)
            elif have != kind and not (is_text(have) and is_text(kind)):
                self.fail(node, f"{lt} {op} {rt}")
        if op in ("AND", "OR") and kind in ("BOOL", "WORD"):
            ops = {"AND": lambda a, b: a & b, "OR": lambda a, b: a | b}
        elif op in ("=", "<>") and not (isinstance(kind, tuple) and kind[0] != "string"):
            ops = {"=": lambda a, b: a == b, "<>": lambda a, b: a != b}
            kind = "BOOL"
        elif op in ("<", "<=", ">", ">=") and (kind in INTS or kind in ("REAL", "TIME")):
            ops = {"<": lambda a, b: a < b, "<=": lambda a, b: a <= b}
            ops.update({">": lambda a, b: a > b, ">=": lambda a, b: a >= b})
            kind = "BOOL"
        elif op in ("+", "-", "*") and (kind in INTS or kind == "REAL"):
            ops = {"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b}
        elif op == "/" and kind == "REAL":
            ops = {"/": lambda a, b: a / b}
        else:
            self.fail(node, f"{op} does not fit {kind}")
        run, limits = ops[op], INTS.get(kind)

        def value(f):
            result = run(left(f), right(f))
            if limits and not limits[0] <= result <= limits[1]:
                self.fail(node, f"{result} does not fit into {kind}")
            return result

        return kind, value

    def function(self, node):
        name = str(getattr(node.name, "name", node.name)).upper()
        args = [self.typed(p.value) for p in node.parameters]
        if "_TO_" in name:
            pair = tuple(name.split("_TO_"))
            have = "STRING" if isinstance(args[0][0], tuple) and args[0][0][0] == "string" else args[0][0]
            if have == "literal" and pair[0] in INTS:
                have = pair[0]
            if len(args) != 1 or pair not in CONVERSIONS or have != pair[0]:
                self.fail(node, f"{name} of {have}")
            run, get = CONVERSIONS[pair], args[0][1]
            return (("string", 5) if pair[1] == "STRING" else pair[1]), lambda f: run(get(f))
        text = lambda i: is_text(args[i][0])
        number = lambda i: args[i][0] in ("literal", "INT")
        values = [a[1] for a in args]
        if name == "CONCAT" and len(args) == 2 and text(0) and text(1):
            return ("string", 255), lambda f: self.limit(node, values[0](f) + values[1](f))
        if name == "LEN" and len(args) == 1 and text(0):
            return "INT", lambda f: len(values[0](f))
        if name == "FIND" and len(args) == 2 and text(0) and text(1):
            return "INT", lambda f: values[0](f).find(values[1](f)) + 1
        if name == "MID" and len(args) == 3 and text(0) and number(1) and number(2):
            return ("string", 255), lambda f: values[0](f)[values[2](f) - 1 : values[2](f) - 1 + values[1](f)]
        self.fail(node, f"function {name} with {[a[0] for a in args]} is unknown")

    def limit(self, node, text):
        if len(text) > 255:
            self.fail(node, f"CODESYS cuts a text of {len(text)} bytes at 255")
        return text


def from_scl(text):
    """Rewrites the few things in which our SCL differs from structured text. Data blocks become structures."""
    bare = re.sub(r"//[^\n]*", "", text)
    bare = re.sub(r"\{[^}]*\}", "", bare)
    bare = re.sub(r"(?m)^\s*(VERSION|TITLE)\s*[:=].*$", "", bare)
    bare = re.sub(r"(?m)^\s*(NON_RETAIN|BEGIN)\s*$", "", bare)
    bare = re.sub(r"\bTON_TIME\b", "TON", bare)
    bare = re.sub(r'DATA_BLOCK\s+"(\w+)"\s*VAR\b(.*?)END_VAR\s*(?:(?!END_DATA_BLOCK).)*END_DATA_BLOCK',
                  r"TYPE \1 : STRUCT \2 END_STRUCT;\nEND_TYPE", bare, flags=re.S)
    bare = re.sub(r'TYPE\s+"(\w+)"\s*STRUCT', r"TYPE \1 :\nSTRUCT", bare)
    for part in re.findall(r"FUNCTION_BLOCK.*?END_FUNCTION_BLOCK", bare, re.S):
        code = part[part.rindex("END_VAR") :]
        declared = {n.lower() for n in re.findall(r"(?m)^\s*(\w+)\s*:\s", part[: part.rindex("END_VAR")])}
        # Without #, TIA Portal would look for a global tag.
        for name in re.findall(r"(?<![#\w.\"])([A-Za-z]\w*)(?![\w\"(])", re.sub(r"(?<=[(,])\s*\w+\s*:=", ":=", code)):
            if name.lower() in declared:
                raise StError(f"{name} lacks # in SCL")
        missing = {n.lower() for n in re.findall(r"(?<!\w)#([A-Za-z_]\w*)", code)} - declared
        if missing:
            raise StError(f"{missing} is not declared in SCL")
    return re.sub(r'"(\w+)"', r"\1", re.sub(r"(?<!\w)#(?=[A-Za-z_])", "", bare))
