"""Estimators, whose points over an averaging time are published while the signal flows; and finding them all."""

import functools
import importlib
import inspect
import pkgutil
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar
from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.block_means import BlockMeans
from stream.estimators.follower import (
    EstimatorState,
    Follower,
    NoEstimate,
    contiguous_runs,
    first_finite,
)
from stream.estimators.noise_kernel import descend, weighted_least_squares
from stream.events import EstimatePoint

__all__ = [
    "Estimator",
    "EstimatorState",
    "Follower",
    "NoEstimate",
    "contiguous_runs",
    "default_estimators",
    "default_followers",
    "estimator_classes",
    "first_finite",
    "follower_classes",
    "warm_up",
]

_PACKAGE = __name__.rpartition(".")[0]


class Estimator(Follower):
    """A quantity of one signal at one or more averaging times, known while the signal flows.

    Every signal is given one of each kind by default (`default_estimators`), and their points are published.

    Attributes
    ----------
    variants : tuple of dict
        Arguments of the instances that every signal is given by default.
    """

    variants: ClassVar[tuple[dict[str, Any], ...]] = ({},)

    @abstractmethod
    def estimate(self) -> tuple[EstimatePoint, ...] | NoEstimate:
        """What is known now, in `unit_of_measure`; never NaN or infinite."""


def follower_classes() -> tuple[type[Follower], ...]:
    """Everything concrete in this package that follows a signal, by name of its class.

    Examples
    --------
    >>> [cls.__name__ for cls in follower_classes()]
    ['AllanDeviation', 'BiasStability', 'SpectralDensity']
    """
    package = importlib.import_module(_PACKAGE)
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{_PACKAGE}.{module.name}")
    found: set[type[Follower]] = set()
    waiting = list(Follower.__subclasses__())
    while waiting:
        cls = waiting.pop()
        waiting.extend(cls.__subclasses__())
        if not inspect.isabstract(cls) and cls.__module__.startswith(f"{_PACKAGE}."):
            found.add(cls)
    return tuple(sorted(found, key=lambda cls: cls.__name__))


def estimator_classes() -> tuple[type[Estimator], ...]:
    """Every concrete estimator of this package, by name of its class."""
    return tuple(cls for cls in follower_classes() if issubclass(cls, Estimator))


def default_estimators() -> dict[str, Callable[[], Estimator]]:
    """Factories of the estimators that a signal is given unless told otherwise, by their keys.

    Examples
    --------
    >>> sorted(default_estimators())  # doctest: +NORMALIZE_WHITESPACE
    ['allan_deviation', 'bias_stability_100s', 'bias_stability_10s', 'bias_stability_10s_over_3600s',
     'bias_stability_1s', 'bias_stability_raw']
    """
    factories = [functools.partial(cls, **variant) for cls in estimator_classes() for variant in cls.variants]
    return {factory().key: factory for factory in factories}


def default_followers() -> dict[str, Callable[[], Follower]]:
    """The default estimators, and of all else that follows a signal an instance without arguments, by their keys.

    Examples
    --------
    >>> sorted(default_followers().keys() - default_estimators().keys())
    ['spectral_density']
    """
    others = {cls.key: cls for cls in follower_classes() if not issubclass(cls, Estimator)}
    return {**default_estimators(), **others}


def warm_up() -> None:
    """Compile the machine code of all that follow a signal, or load it where it was compiled before.

    It is kept on disk beside the modules, or in the user's cache directory where that cannot be written; compiling
    takes some seconds, once an installation.
    """
    values = np.array([1.0, np.nan, 2.0, 4.0])
    times_ns = np.array([0, 1, 5, 6], np.int64) * 10**9
    regular = SampleBatch("unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values)
    irregular = SampleBatch(
        "unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values, times_ns=times_ns, irregular=True
    )
    for factory in default_followers().values():
        for batch in (regular, irregular):
            follower = factory()
            follower.update(batch)
            follower.merge(follower.successor())
            follower.estimate()
    for batch in (regular, irregular):
        BlockMeans(1.0).push(batch)
    descend(np.ones((2, 1)), np.ones(2), np.ones(1), np.ones(1, np.bool_))
    weighted_least_squares(np.ones((2, 1)), np.ones(2), np.ones(2), np.zeros(2), np.ones(1, np.bool_))
