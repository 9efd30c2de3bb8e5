"""Figures of the code as a whole; `python tests/house_figures.py` prints them, `tests/test_house.py` holds them."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TypeGuard

ROOT = Path(__file__).resolve().parents[1]
CODE = (ROOT / "labdaemon", ROOT / "drivers")

IDIOMS = re.compile(
    r"\b(besides?|nobody|tells|told|telling|chances?|honest|honesty|sought|astray|pictures?|alike|odd|strays?|grain"
    r"|in hand|under way|goes on|put down to|whatever else)\b",
    re.IGNORECASE,
)
"""Words that readers with English as a second language misread, or that have a term in the field."""

PARTICIPLE = re.compile(
    r"^_?[A-Z][a-z]+(ed|ing|ly|able|ible|ous|ive|est)$|^_?(Held|Met|Kept|Known|Seen|Sought|Told|Lost)$"
)
"""One-word class names that are participles, adverbs or adjectives."""
NOUNS = {"Bearing", "Drawing", "Feed", "Firing", "Heading", "Opening", "Reading", "Request"}
NOUNS |= {"Seed", "Setting", "Sibling", "Spacing", "Speed", "Timing"}
"""Names of that form that are nouns."""


@dataclass(frozen=True)
class Figures:
    """What is counted in `labdaemon` and `drivers`; idioms also in documentation and examples.

    Attributes
    ----------
    module_lines
        Lines of each module of more than five.
    function_lines
        Lines of each function.
    annotated
        Share of parameters and results that are annotated.
    idioms
        ``file:line: word`` of each hit of `IDIOMS`.
    lines
        Lines in which idioms are counted.
    classes
        How many classes have each name.
    participles
        One-word class names that are no nouns.
    mocks
        Mocks in the tests.
    code_lines, test_lines
        Lines of code (`LineCounts.code`): neither empty nor comment nor documentation.
    comments
        Comments as a share of code lines (`LineCounts.comments`).
    unannotated
        Public attributes in `labdaemon` without a type of their own.
    """

    module_lines: list[int]
    function_lines: list[int]
    annotated: float
    idioms: list[str]
    lines: int
    classes: Counter[str]
    participles: list[str]
    mocks: int
    code_lines: int
    test_lines: int
    comments: float
    unannotated: list[str]

    @property
    def repeated_classes(self) -> list[str]:
        """Class names that stand for two things."""
        return sorted(name for name, count in self.classes.items() if count > 1)

    @property
    def idioms_per_1000(self) -> float:
        """Hits per 1 000 lines."""
        return 1000 * len(self.idioms) / self.lines

    @property
    def long_functions(self) -> float:
        """Share of functions of more than 60 lines."""
        return sum(lines > 60 for lines in self.function_lines) / len(self.function_lines)

    def __str__(self) -> str:
        return "\n".join(
            (
                f"modules: median {median(self.module_lines):.0f} lines, longest {max(self.module_lines)}",
                f"functions: {100 * self.long_functions:.2f} % over 60 lines, longest {max(self.function_lines)}",
                f"annotated: {100 * self.annotated:.1f} %",
                f"idioms: {self.idioms_per_1000:.2f} per 1 000 lines",
                f"class names used twice: {self.repeated_classes}",
                f"class names that are participles or adjectives: {self.participles}",
                f"mocks: {self.mocks}",
                f"tests : code = {self.test_lines / self.code_lines:.3f} ({self.test_lines} : {self.code_lines} lines)",
                f"comments: {100 * self.comments:.1f} % of code lines",
                f"public attributes without a type: {len(self.unannotated)}",
            )
        )


def sources(*folders: Path) -> Iterator[Path]:
    """Python files of folders."""
    for folder in folders:
        yield from sorted(folder.rglob("*.py"))


@dataclass(frozen=True)
class LineCounts:
    """Lines of one file.

    Attributes
    ----------
    code
        Lines with code, strings in expressions included; no empty lines, comments or docstrings.
    comments
        Lines with a comment (``#``), and lines of the string under an assignment, which documents one setting (other
        houses write ``#:`` there).
    """

    code: int
    comments: int


def count_lines(text: str, tree: ast.Module) -> LineCounts:
    """Count the lines of one file."""
    docstrings: set[int] = set()
    settings: set[int] = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for place, one in enumerate(body if isinstance(body, list) else []):
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str):
                lines = range(one.lineno, (one.end_lineno or one.lineno) + 1)
                (settings if place else docstrings).update(lines)
    code: set[int] = set()
    comments: set[int] = set()
    layout = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.type not in layout:
            code.update(range(token.start[0], token.end[0] + 1))
    return LineCounts(len(code - docstrings - settings), len(comments | settings))


def unannotated_attributes(tree: ast.Module) -> Iterator[str]:
    """``Class.attribute`` of public attributes that an `__init__` sets to something else than its own parameter.

    A type checker infers these, and two checkers may infer different types: pyright calls them ambiguous.
    """
    for node in ast.walk(tree):
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        declared = {one.target.id for one in node.body if isinstance(one, ast.AnnAssign) and _is_name(one.target)}
        for method in node.body:
            if isinstance(method, ast.FunctionDef) and method.name == "__init__":
                yield from (f"{node.name}.{name}" for name in _inferred(method) if name not in declared)


def _inferred(method: ast.FunctionDef) -> Iterator[str]:
    parameters = {one.arg for one in [*method.args.posonlyargs, *method.args.args, *method.args.kwonlyargs]}
    annotated: set[str] = set()
    for node in ast.walk(method):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Attribute):
            annotated.add(node.target.attr)
    for node in ast.walk(method):
        if isinstance(node, ast.Assign):
            is_parameter = isinstance(node.value, ast.Name) and node.value.id in parameters
            for target in node.targets:
                parts = target.elts if isinstance(target, ast.Tuple) else [target]
                for part in parts:
                    is_known = is_parameter and part is target
                    if _is_own(part) and not (is_known or part.attr.startswith("_") or part.attr in annotated):
                        yield part.attr


def _is_name(node: ast.expr) -> TypeGuard[ast.Name]:
    return isinstance(node, ast.Name)


def _is_own(node: ast.expr) -> TypeGuard[ast.Attribute]:
    return isinstance(node, ast.Attribute) and _is_name(node.value) and node.value.id == "self"


def measure() -> Figures:
    """Count everything."""
    module_lines, function_lines, slots, filled = [], [], 0, 0
    classes: Counter[str] = Counter()
    code_lines = comment_lines = 0
    unannotated: list[str] = []
    for path in sources(*CODE):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        module_lines.append(len(text.splitlines()))
        counts = count_lines(text, tree)
        code_lines, comment_lines = code_lines + counts.code, comment_lines + counts.comments
        if ROOT / "labdaemon" in path.parents:
            unannotated += [f"{path.relative_to(ROOT)}: {name}" for name in unannotated_attributes(tree)]
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name] += 1
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                function_lines.append((node.end_lineno or node.lineno) - node.lineno + 1)
                arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                needed = [one for one in arguments if one.arg not in ("self", "cls")]
                slots += len(needed) + 1
                filled += sum(one.annotation is not None for one in needed) + (node.returns is not None)
    idioms, counted = count_idioms()
    tests = [path.read_text(encoding="utf-8") for path in sources(ROOT / "tests") if path.name != Path(__file__).name]
    return Figures(
        [lines for lines in module_lines if lines > 5],
        function_lines,
        filled / slots,
        idioms,
        counted,
        classes,
        sorted(name for name in classes if PARTICIPLE.match(name) and name not in NOUNS),
        sum(len(re.findall(r"\b(Mock|MagicMock|AsyncMock|mock\.patch|mocker)\b", text)) for text in tests),
        code_lines,
        sum(count_lines(text, ast.parse(text)).code for text in tests),
        comment_lines / code_lines,
        unannotated,
    )


def count_idioms() -> tuple[list[str], int]:
    """Hits of `IDIOMS` in code, documentation and examples, and the lines that were read."""
    hits, counted = [], 0
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]
    for path in [*sources(*CODE, ROOT / "docs", ROOT / "examples"), *sorted(pages)]:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            counted += 1
            hits += [f"{path.relative_to(ROOT)}:{number}: {match.group()}" for match in IDIOMS.finditer(line)]
    return hits, counted


if __name__ == "__main__":
    print(measure())
