"""Figures of the code as a whole; `python tests/house_figures.py` prints them, `tests/test_house.py` holds them."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

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
        Lines that are not empty.
    comments
        Share of code lines with a comment.
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
                f"tests : code = {self.test_lines / self.code_lines:.2f}",
                f"comments: {100 * self.comments:.1f} % of code lines",
            )
        )


def sources(*folders: Path) -> Iterator[Path]:
    """Python files of folders."""
    for folder in folders:
        yield from sorted(folder.rglob("*.py"))


def measure() -> Figures:
    """Count everything."""
    module_lines, function_lines, slots, filled = [], [], 0, 0
    classes: Counter[str] = Counter()
    code_lines = comment_lines = 0
    for path in sources(*CODE):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        module_lines.append(len(text.splitlines()))
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        code_lines += len(lines)
        comment_lines += sum("#" in line and not line.startswith(('"', "'")) for line in lines)
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
        sum(sum(bool(line.strip()) for line in text.splitlines()) for text in tests),
        comment_lines / code_lines,
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
