"""A small interpreter of URScript, which knows the grammar of its manual and nothing of excitant.

Statements are lines: ``def`` and ``while`` up to ``end``, with assignments, ``global`` or
``local``, and calls; what else the manual has is refused. A free variable is the global of its name
where there is one, else local. Commands of the arm take time; what they command is kept with it.
"""

import ast
import operator as op
import re
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np

ORDERED = {ast.Lt: op.lt, ast.Gt: op.gt, ast.LtE: op.le, ast.GtE: op.ge}
COMPARED = {ast.Eq: op.eq, ast.NotEq: op.ne} | ORDERED
COMBINED = {ast.Add: op.add, ast.Sub: op.sub, ast.Mult: op.mul, ast.Div: op.truediv}
COMBINED |= {ast.Mod: op.mod}
SIGNATURES = {
    "movej": ("q", "a", "v", "t", "r"),
    "servoj": ("q", "a", "v", "t", "lookahead_time", "gain"),
    "stopj": ("a",),
    "get_steptime": (),
}


class Controller:
    """A program and what it commands: times [s] and poses [rad] of every step of `servoj`."""

    def __init__(self, text: str, steptime: float) -> None:
        assert text.isascii(), "the controller reads ASCII"
        self.steptime, self.time = steptime, 0.0
        self.names: dict[str, Any] = {}
        self.functions: dict[str, tuple[list[str], list[str]]] = {}
        self.times, self.poses = list[float](), list[list[float]]()
        self.moved, self.stopped = list[tuple[list[float], dict[str, float]]](), False
        lines = [line.partition("#")[0].rstrip() for line in text.splitlines()]
        self.run([line.strip() for line in lines if line.strip()], self.names)

    def run(self, lines: list[str], own: dict[str, Any]) -> None:
        """Run statements with local names of their own, those of the program at its level."""
        k = 0
        while k < len(lines):
            if head := re.fullmatch(r"(?:def (\w+)\(([\w, ]*)\)|while (.*)):", lines[k]):
                body = lines[k + 1 : end_of(lines, k)]
                k += len(body) + 2
                if head[1]:
                    self.functions[head[1]] = (re.findall(r"\w+", head[2]), body)
                while head[3] and self.value(head[3], own):
                    self.run(body, own)
            else:
                self.simple(lines[k], own)
                k += 1

    def simple(self, line: str, own: dict[str, Any]) -> None:
        found = re.fullmatch(r"(?:(global|local) )?([A-Za-z_]\w*) = (.*)", line)
        if found is None:
            assert re.match(r"\w+\(", line), f"neither a call nor an assignment: {line}"
            self.value(line, own)
            return
        assert found[2] not in SIGNATURES, f"{found[2]} is a function of the controller"
        scope = {"global": self.names, "local": own}.get(found[1] or "")
        if scope is None:
            scope = self.names if found[2] in self.names else own
        scope[found[2]] = self.value(found[3], own)

    def value(self, text: str, own: dict[str, Any]) -> Any:
        """Of an expression: all that URScript has of them, Python reads alike."""
        return self.of(parsed(text), own)

    def of(self, node: ast.expr, own: dict[str, Any]) -> Any:
        match node:
            case ast.Constant(value=value) if type(value) in (int, float):
                return value
            case ast.Name(id=name):
                return own[name] if name in own else self.names[name]
            case ast.List(elts=entries):
                return [self.of(each, own) for each in entries]
            case ast.Subscript(value=entries, slice=place):
                return self.of(entries, own)[self.of(place, own)]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.of(operand, own)
            case ast.Compare(left=a, ops=[sign], comparators=[b]) if type(sign) in COMPARED:
                return COMPARED[type(sign)](self.of(a, own), self.of(b, own))
            case ast.BinOp(left=a, op=sign, right=b) if type(sign) in COMBINED:
                values = self.of(a, own), self.of(b, own)
                assert list not in map(type, values), "arithmetic of lists is not in every version"
                return COMBINED[type(sign)](*values)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=named):
                given = [(k.arg or "", self.of(k.value, own)) for k in named]
                return self.call(name, [("", self.of(each, own)) for each in args] + given)
        raise AssertionError(f"not URScript: {ast.unparse(node)}")

    def call(self, name: str, given: list[tuple[str, Any]]) -> Any:
        if name in self.functions:
            parameters, body = self.functions[name]
            assert len(parameters) == len(given), name
            self.run(body, dict(zip(parameters, (each for _, each in given), strict=True)))
            return None
        parameters = list(SIGNATURES[name])
        values = {key or parameters[k]: each for k, (key, each) in enumerate(given)}
        assert len(values) == len(given)
        assert values.keys() <= set(parameters), f"{name} has no {values.keys() - set(parameters)}"
        return getattr(self, name)(**values)

    def get_steptime(self) -> float:
        return self.steptime

    def movej(self, q: list[float], **how: float) -> None:
        assert len(q) == 6
        assert how["a"] > 0
        assert how["v"] > 0
        self.moved.append((q, how))

    def stopj(self, a: float) -> None:
        self.stopped = a > 0

    def servoj(self, q: list[float], t: float, lookahead_time: float, gain: float) -> None:
        """Take a step, or several to one pose; the ranges are those of the manual."""
        assert len(q) == 6
        assert 0.03 <= lookahead_time <= 0.2
        assert 100 <= gain <= 2000
        steps = t / self.steptime
        assert steps > 0.5
        assert abs(steps - round(steps)) < 1e-6, f"{t} s is no whole number of steps"
        for _ in range(round(steps)):
            self.times.append(self.time)
            self.poses.append(q)
            self.time += self.steptime

    @property
    def commanded(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.times), np.array(self.poses)


@cache
def parsed(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def end_of(lines: list[str], k: int) -> int:
    """Line of the ``end`` of the statement that begins at line k."""
    steps = [bool(re.match(r"(def|while)\b", line)) - (line == "end") for line in lines[k:]]
    depths = list(accumulate(steps))
    assert 0 in depths, f"no end: {lines[k]}"
    return k + depths.index(0)
