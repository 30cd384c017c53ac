"""Determinants and inverses of small matrices of terms, written out."""

import functools

from rotorid_torch.core.native.graph.symbols import Term

LARGEST = 3
"""Order up to which cofactors are no more work than elimination, and as accurate."""

Matrix = list[list[Term]]


def determinant(rows: Matrix) -> Term:
    """By the first row's cofactors."""
    if len(rows) == 1:
        return rows[0][0]
    parts = [rows[0][j] * determinant(_without(rows, 0, j)) * (-1.0) ** j for j in range(len(rows))]
    return functools.reduce(lambda a, b: a + b, parts)


def inverse(rows: Matrix) -> Matrix:
    """By Cramer's rule."""
    n = len(rows)
    if n == 1:
        return [[1.0 / rows[0][0]]]
    whole = determinant(rows)
    return [[determinant(_without(rows, j, i)) * (-1.0) ** (i + j) / whole for j in range(n)] for i in range(n)]


def _without(rows: Matrix, i: int, j: int) -> Matrix:
    return [[t for k, t in enumerate(row) if k != j] for m, row in enumerate(rows) if m != i]
