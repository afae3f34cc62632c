"""Collinearity of the regressors of a model found, and the leverage of each run on their coefficients."""

import msgspec
import numpy as np

from analytics.loop.model.error_model import ErrorModel
from analytics.loop.residuals import Residuals


class Regressor(msgspec.Struct, frozen=True, kw_only=True):
    """A column of the model, whitened, on the training blocks.

    Parameters
    ----------
    vif: Variance inflation factor, 1 / (1 - R^2) of its regression on the other columns; None if they determine it.
    nearest: The column that it is most correlated with, and the correlation; empty and 0 if it is alone.
    leverage: Share of each run in what determines its coefficient.
    """

    name: str
    vif: float | None
    nearest: str
    correlation: float
    leverage: dict[str, float]


class RegressorDiagnostics(msgspec.Struct, frozen=True, kw_only=True):
    """Regressors of a model, and the condition number of their correlation matrix (square root of eigenvalues)."""

    condition: float
    regressors: tuple[Regressor, ...]


def regressor_diagnostics(residuals: Residuals, model: ErrorModel) -> RegressorDiagnostics | None:
    """Diagnostics of the columns of a model; None without a column (Belsley, Kuh and Welsch, 1980)."""
    stack = residuals.record.stack
    labels = list(model.labels())
    columns = residuals.record.whitener(residuals.noise)(stack.column(model.columns))
    fitted = ~residuals.held_out if residuals.held_out.any() else residuals.judged
    columns, run = columns[fitted], stack.run_number[fitted]
    length = np.linalg.norm(columns, axis=0)
    if not labels or not np.all(length > 0):
        return None
    columns = columns / length
    correlation = columns.T @ columns
    eigenvalues = np.linalg.eigvalsh(correlation)
    found = []
    for at, label in enumerate(labels):
        others = np.delete(columns, at, axis=1)
        alone = columns[:, at]
        if others.shape[1]:
            alone = alone - others @ np.linalg.lstsq(others, alone, rcond=None)[0]
        left = float(alone @ alone)
        shares = np.bincount(run, alone**2, minlength=len(stack.runs)) / max(left, 1e-300)
        near = np.abs(correlation[at]) * (np.arange(len(labels)) != at)
        most = int(np.argmax(near))
        found.append(
            Regressor(
                name=label,
                vif=1.0 / left if left > 1e-12 else None,
                nearest=labels[most] if others.shape[1] else "",
                correlation=float(correlation[at, most]) if others.shape[1] else 0.0,
                leverage={each.run: float(shares[number]) for number, each in enumerate(stack.runs) if shares[number]},
            )
        )
    condition = float(np.sqrt(eigenvalues[-1] / max(float(eigenvalues[0]), 1e-300)))
    return RegressorDiagnostics(condition=condition, regressors=tuple(found))
