"""Estimators, whose points over an averaging time are published while the signal flows; and finding them all."""

import functools
import importlib
import inspect
import pkgutil
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from stream.estimators.follower import EstimatorState, Follower, NoEstimate, contiguous_runs, first_finite
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
]

_PACKAGE = __name__.rpartition(".")[0]


class Estimator(Follower):
    """A quantity of one signal at one or more averaging times, known while the signal flows.

    Every signal is given one of each kind by default (`default_estimators`), and their points are published.

    Attributes
    ----------
    variants: Arguments of the instances that every signal is given by default.
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
