"""What is closed by leaving a ``with``."""

from abc import abstractmethod
from typing import Self


class Closing:
    """Base class of what has a `close` that ends a ``with``."""

    @abstractmethod
    def close(self) -> None:
        """End it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
