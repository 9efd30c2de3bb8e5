"""A sequence of which the elements have names: by position as any sequence, by name as a mapping."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import TypeVar, overload

T = TypeVar("T")


class NamedSequence(Sequence[T]):
    """Base of results that are looked up by the name of a target or a capture."""

    __slots__ = ()

    @abstractmethod
    def _elements(self) -> tuple[T, ...]:
        """All elements, in order."""

    @abstractmethod
    def _name_of(self, element: T) -> str:
        """Name of an element."""

    @abstractmethod
    def _missing(self, name: str) -> str:
        """Message for a name that no element has."""

    def __len__(self) -> int:
        return len(self._elements())

    @overload
    def __getitem__(self, index: int | str) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[T]: ...

    def __getitem__(self, index: int | str | slice) -> T | Sequence[T]:
        """By position, or by name.

        Raises
        ------
        KeyError
            No element has that name.
        """
        if isinstance(index, str):
            for element in self._elements():
                if self._name_of(element) == index:
                    return element
            raise KeyError(self._missing(index))
        return self._elements()[index]

    def __iter__(self) -> Iterator[T]:
        return iter(self._elements())
