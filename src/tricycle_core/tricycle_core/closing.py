"""Base of objects that hold a resource and are closed once."""

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self


class Closing(ABC):
    """Base of classes that hold a resource: ``with`` closes it."""

    @abstractmethod
    def close(self) -> None:
        """Give the resource back; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
