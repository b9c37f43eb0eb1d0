"""The plant's kernel as C, translated from its Python source, so that there is one plant and not two.

Only what the kernel uses is known: numbers, attributes of ``p``, ``x`` and ``seen``, arrays, loops, conditions, and
functions that return a number or up to three. Anything else is an error here, not a wrong plant.
"""

from __future__ import annotations

import ast
import inspect
import math

from hil.plant import kernel
from hil.plant.layout import CHANNELS

FUNCTIONS = ("profile", "in_use", "screw_error", "cylinder", "stribeck", "chain", "pull", "step", "observe")
"""Of the kernel, each after those that it calls."""
_VOID, _INTEGER, _SEVERAL = ("cylinder", "step", "observe"), ("in_use",), ("profile", "chain")
_PARAMETERS = {
    "p": "const Parameters *p", "parameters": "const Parameters *p", "x": "State *x", "state": "State *x",
    "view": "View *seen", "nodes": "double (*nodes)[4]", "pulls": "double (*pulls)[2]", "inputs": "Inputs *inputs",
}  # fmt: skip
_INTEGERS = {"i", "j", "axis", "count", "last", "used", "first", "after", "channel", "braked", "_", "_sweep"}
_OF_INPUTS = ("segments", "spans", "tones", "tone_spans", "cursor")
_RECORDS = ("p", "x", "seen")
_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitAnd: "&", ast.BitOr: "|", ast.LShift: "<<",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.And: "&&",
    ast.Or: "||", ast.USub: "-", ast.Not: "!",
}  # fmt: skip
_CALLS = {"abs": "fabs", "min": "least", "max": "most"}
_PARTS = ("a", "b", "c")


class TranslationError(ValueError):
    """Something in the kernel that this translation does not know; ``str()`` says what and where."""


def translated() -> str:
    """C of all functions of the kernel that a step and a view need."""
    return "\n".join(_Function(name).text() for name in FUNCTIONS)


class _Function:
    def __init__(self, name: str) -> None:
        source = inspect.getsource(getattr(kernel, name).py_func)
        (self._tree,) = ast.parse(source).body
        self._name, self._lines, self._depth, self._temporaries = name, [""] * 0, 1, 0

    def text(self) -> str:
        assert isinstance(self._tree, ast.FunctionDef)
        names = [argument.arg for argument in self._tree.args.args]
        stored = {node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)
                  and isinstance(node.ctx, ast.Store)}  # fmt: skip
        local = sorted(stored - {*names, *_OF_INPUTS, *_RECORDS})
        for node in self._tree.body:
            self._statement(node)
        kind = "void" if self._name in _VOID else "int" if self._name in _INTEGER else "double"
        kind = "Several" if self._name in _SEVERAL else kind
        given = ", ".join(_PARAMETERS.get(name) or f"{_type(name)} {_local(name)}" for name in names)
        declared = [f"    {_type(name)} {_local(name)} = 0;" for name in local]
        return "\n".join([f"static {kind} {self._name}({given})", "{", *declared, *self._lines, "}", ""])

    def _unknown(self, node: ast.AST) -> TranslationError:
        line = getattr(node, "lineno", 0)
        return TranslationError(f"kernel.{self._name}, line {line}: found {ast.dump(node)[:80]}, which has no C here")

    # -- statements -----------------------------------------------------------------------------------------
    def _put(self, line: str) -> None:
        self._lines.append("    " * self._depth + line)

    def _block(self, head: str, body: list[ast.stmt]) -> None:
        self._put(head + " {")
        self._depth += 1
        for node in body:
            self._statement(node)
        self._depth -= 1
        self._put("}")

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Expr(ast.Constant(str())):
                pass
            case ast.Expr(ast.Call() as call):
                self._put(f"{self._value(call)};")
            case ast.Assign(targets, value):
                self._assign(targets, value)
            case ast.AugAssign(target, operator, value):
                self._put(f"{self._value(target)} {_OPERATORS[type(operator)]}= {self._value(value)};")
            case ast.If(test, body, otherwise):
                self._block(f"if ({self._value(test)})", body)
                if otherwise:
                    self._block("else", otherwise)
            case ast.While(test, body):
                self._block(f"while ({self._value(test)})", body)
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds), body):
                low, high = (["0"] + [self._value(bound) for bound in bounds])[-2:]
                name = _local(name)
                self._block(f"for ({name} = {low}; {name} < {high}; {name}++)", body)
            case ast.Break():
                self._put("break;")
            case ast.Return(ast.Tuple(elements)):
                self._put(f"return (Several){{{', '.join(map(self._value, elements))}}};")
            case ast.Return(ast.expr() as value):
                self._put(f"return {self._value(value)};")
            case _:
                raise self._unknown(node)

    def _assign(self, targets: list[ast.expr], value: ast.expr) -> None:
        if isinstance(targets[0], ast.Tuple):
            self._unpack(list(targets[0].elts), value)
            return
        found = self._value(value)
        for target in reversed(targets):
            self._put(f"{self._value(target)} = {found};")
            found = self._value(target)

    def _unpack(self, targets: list[ast.expr], value: ast.expr) -> None:
        names = {target.id for target in targets if isinstance(target, ast.Name)}
        if names and names <= {*_OF_INPUTS, *_RECORDS}:
            return  # what C has in structs
        if isinstance(value, ast.Tuple):
            parts = [self._value(element) for element in value.elts]
        elif isinstance(value, ast.Subscript):
            parts = [f"{self._value(value)}[{place}]" for place in range(len(targets))]
        else:
            self._temporaries += 1
            several = f"several_{self._temporaries}"
            self._put(f"const Several {several} = {self._value(value)};")
            parts = [f"{several}.{part}" for part in _PARTS]
        kept = [(target, part) for target, part in zip(targets, parts, strict=False)]
        if isinstance(value, ast.Tuple):  # all are read before the first is written
            for place, (_, part) in enumerate(kept):
                self._put(f"const double kept_{self._temporaries}_{place} = {part};")
            kept = [(target, f"kept_{self._temporaries}_{place}") for place, (target, _) in enumerate(kept)]
            self._temporaries += 1
        for target, part in kept:
            self._put(f"{self._value(target)} = {part};")

    # -- values ---------------------------------------------------------------------------------------------
    def _value(self, node: ast.expr) -> str:  # noqa: PLR0912 - one row for each kind of node
        match node:
            case ast.Constant(bool() as value):
                return str(int(value))
            case ast.Constant(int() | float() as value):
                return repr(value)
            case ast.Name(name):
                return self._named(name)
            case ast.Attribute(ast.Name("math"), "pi" | "inf" as name):
                return "INFINITY" if name == "inf" else repr(math.pi)
            case ast.Attribute(ast.Name(record), name) if record in _RECORDS:
                return f"{record}->{name}"
            case ast.BinOp(left, operator, right) if type(operator) in _OPERATORS:
                return f"({self._value(left)} {_OPERATORS[type(operator)]} {self._value(right)})"
            case ast.UnaryOp(operator, value):
                return f"({_OPERATORS[type(operator)]}{self._value(value)})"
            case ast.BoolOp(operator, values):
                return f"({f' {_OPERATORS[type(operator)]} '.join(map(self._value, values))})"
            case ast.Compare(left, operators, others):
                return self._comparison([left, *others], operators)
            case ast.IfExp(test, then, otherwise):
                return f"({self._value(test)} ? {self._value(then)} : {self._value(otherwise)})"
            case ast.Subscript(ast.Call() as call, ast.Constant(int() as place)):
                return f"{self._value(call)}.{_PARTS[place]}"
            case ast.Subscript(array, ast.Tuple(places)):
                return self._value(array) + "".join(f"[{self._value(place)}]" for place in places)
            case ast.Subscript(array, place):
                return f"{self._value(array)}[{self._value(place)}]"
            case ast.Call(function, arguments, []):
                return self._call(function, arguments)
        raise self._unknown(node)

    def _named(self, name: str) -> str:
        if name in _OF_INPUTS:
            return f"inputs->{name}"
        constant = getattr(kernel, name, None)
        if name == "_STILL":
            return "STILL"
        if isinstance(constant, int | float) and name.isupper():
            return repr(constant)
        return _local(name)

    def _comparison(self, values: list[ast.expr], operators: list[ast.cmpop]) -> str:
        pairs = zip(values, operators, values[1:], strict=False)
        return "(" + " && ".join(
            f"{self._value(left)} {_OPERATORS[type(operator)]} {self._value(right)}" for left, operator, right in pairs
        ) + ")"  # fmt: skip

    def _call(self, function: ast.expr, arguments: list[ast.expr]) -> str:
        given = ", ".join(map(self._value, arguments))
        match function:
            case ast.Name("int"):
                return f"((int){given})"
            case ast.Name("len"):
                return str(CHANNELS)
            case ast.Name(name) if name in _CALLS or name in FUNCTIONS:
                return f"{_CALLS.get(name, name)}({given})"
            case ast.Attribute(ast.Name("math"), "sin" | "cos" | "sqrt" | "exp" | "atan2" | "copysign" as name):
                return f"{name}({given})"
        raise self._unknown(function)


def _type(name: str) -> str:
    return "int" if name in _INTEGERS else "double"


def _local(name: str) -> str:
    """A name that C takes, too."""
    return {"_": "pass_", "static": "static_"}.get(name, name)
