"""A small interpreter of URScript, which knows the grammar of its manual and nothing of excitant.

Statements are lines: ``def`` and ``while`` up to ``end``, with assignments, ``global`` or
``local``, and calls; what else the manual has is refused. A free variable is the global of its name
where there is one, else local. Commands of the arm take time; what they command is kept with it.
"""

import re
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np

TOKEN = re.compile(
    r"\s*(?:(\d+\.?\d*(?:[eE][-+]?\d+)?)|([A-Za-z_]\w*)|(<=|>=|==|!=|[-+*/%()\[\],<>=]))"
)
LEVELS = (("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "%"))
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
        tokens = list(split(text))
        value = self.binary(tokens, own, 0)
        assert not tokens, f"unexpected {tokens[0]} in: {text}"
        return value

    def binary(self, tokens: list[str], own: dict[str, Any], level: int) -> Any:
        if level == len(LEVELS):
            return self.unary(tokens, own)
        value = self.binary(tokens, own, level + 1)
        while tokens and tokens[0] in LEVELS[level]:
            operation = tokens.pop(0)
            value = apply(operation, value, self.binary(tokens, own, level + 1))
        return value

    def unary(self, tokens: list[str], own: dict[str, Any]) -> Any:
        token = tokens.pop(0)
        if token == "-":
            return -self.unary(tokens, own)
        if token == "(":
            value = self.binary(tokens, own, 0)
            assert tokens.pop(0) == ")"
        elif token == "[":
            value = [each for _, each in self.listed(tokens, own, "]")]
        elif token[0].isdigit():
            value = float(token) if re.search(r"[.eE]", token) else int(token)
        elif tokens and tokens[0] == "(":
            tokens.pop(0)
            value = self.call(token, self.listed(tokens, own, ")"))
        else:
            value = own[token] if token in own else self.names[token]
        while tokens and tokens[0] == "[":
            tokens.pop(0)
            value = value[self.binary(tokens, own, 0)]
            assert tokens.pop(0) == "]"
        return value

    def listed(self, tokens: list[str], own: dict[str, Any], end: str) -> list[tuple[str, Any]]:
        found = []
        while tokens[0] != end:
            name = tokens.pop(0) if len(tokens) > 1 and tokens[1] == "=" else ""
            if name:
                tokens.pop(0)
            found.append((name, self.binary(tokens, own, 0)))
            assert tokens[0] in (end, ",")
            if tokens[0] == ",":
                tokens.pop(0)
        tokens.pop(0)
        return found

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
def split(text: str) -> tuple[str, ...]:
    text, place, tokens = text.strip(), 0, list[str]()
    while place < len(text):
        found = TOKEN.match(text, place)
        assert found, f"not URScript: {text[place:]}"
        tokens.append(found[found.lastindex or 0])
        place = found.end()
    return tuple(tokens)


def apply(operation: str, a: Any, b: Any) -> Any:
    if operation in LEVELS[0]:
        ordered = {"<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b}
        return ({"==": a == b, "!=": a != b} | ordered)[operation]
    assert not isinstance(a, list), "arithmetic of lists is not in every version"
    assert not isinstance(b, list), "arithmetic of lists is not in every version"
    if operation == "/":
        return a / b
    return {"+": a + b, "-": a - b, "*": a * b, "%": a % b if b else 0}[operation]


def end_of(lines: list[str], k: int) -> int:
    """Line of the ``end`` of the statement that begins at line k."""
    steps = [bool(re.match(r"(def|while)\b", line)) - (line == "end") for line in lines[k:]]
    depths = list(accumulate(steps))
    assert 0 in depths, f"no end: {lines[k]}"
    return k + depths.index(0)
