"""Matrices of foreign models with the names of their degrees of freedom, whatever the format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy import io, sparse

from fosopt.errors import did_you_mean
from fosopt.structure.readers.common import (
    bad,
    dof_name,
    file_bytes,
    real_array,
    split_dof,
    table_rows,
    text_lines,
    unique_dofs,
)
from fosopt.structure.readers.dmig import read_dmig
from fosopt.structure.readers.modal_set import matlab_file, numpy_archive
from fosopt.structure.readers.op4 import read_op4
from fosopt.units import quote

# Text formats keep six digits or more.
_UNEVEN = 1e-6
# Keys of the arrays in which SciPy keeps a sparse matrix.
_SPARSE_KEYS = {"indices", "indptr", "format", "shape", "data"}


@dataclass(frozen=True)
class MatrixFile:
    """A symmetric matrix of a file, in its units.

    Attributes
    ----------
    file
        Where it was read.
    matrix
        (n, n).
    dofs
        (n,) names such as ``101.rz``, where the file has them.
    """

    file: Path
    matrix: sparse.csc_array
    dofs: tuple[str, ...] | None = None


def read_matrix(file: Path, name: str | None = None) -> MatrixFile:
    """A symmetric matrix of a Matrix Market, MATLAB, NumPy, OUTPUT4 or DMIG file.

    Parameters
    ----------
    name
        Of the matrix, where the file holds several.

    Raises
    ------
    StudyError
        For a file that is missing, truncated or of another format, an unknown name, and a matrix that is complex, not
        finite, not square or not symmetric.
    """
    suffix = file.suffix.lower()
    if suffix in (".pch", ".dmig", ".bdf", ".dat", ".nas"):
        dmig = read_dmig(file)
        matrix, dofs = dmig[_chosen(file, dmig, name)]
        return MatrixFile(file, _symmetric(file, matrix), dofs)
    if suffix == ".mtx":
        found: dict[str, object] = {"": _matrix_market(file)}
        name = None
    elif suffix == ".op4":
        found, name = dict(read_op4(file)), None if name is None else name.upper()
    elif suffix == ".mat":
        found = {key: value for key, value in matlab_file(file).items() if getattr(value, "ndim", 0) == 2}
    elif suffix == ".npz":
        found = _numpy(file)
    else:
        raise bad(file, f"{quote(file.suffix)} is no format of a matrix; use .mtx, .mat, .npz, .op4 or .pch")
    key = _chosen(file, found, name)
    value = found[key]
    if sparse.issparse(value):
        coo = sparse.coo_array(value)
        data = real_array(file, coo.data, key or "the matrix")
        matrix = sparse.csc_array((data, coo.coords), shape=coo.shape)
    else:
        matrix = sparse.csc_array(np.atleast_2d(real_array(file, value, key or "the matrix")))
    return MatrixFile(file, _symmetric(file, matrix))


def _chosen(file: Path, found: Mapping[str, object], name: str | None) -> str:
    if name is not None:
        if name not in found:
            raise bad(file, f"the file has no matrix {quote(name)}; {did_you_mean(name, found)}")
        return name
    if len(found) != 1:
        raise bad(
            file, f"the file holds {len(found)} matrices; name one of {', '.join(sorted(found)) or 'them'}"
        )
    return next(iter(found))


def _matrix_market(file: Path) -> object:
    content = file_bytes(file)
    try:
        rows, columns, entries, kind, _, symmetry = io.mminfo(BytesIO(content))
        found = io.mmread(BytesIO(content))
    except Exception as error:  # a third-party parser may fail in its own ways on broken text
        reason = " ".join(str(error).split()) or type(error).__name__
        raise bad(file, f"truncated or no Matrix Market file ({reason}); write it again") from None
    # SciPy fills up with zeros what an array lacks.
    if kind == "array":
        entries = rows * columns if symmetry == "general" else rows * (rows + 1) // 2
    lines = sum(1 for line in content.splitlines() if line.strip() and not line.startswith(b"%")) - 1
    if lines != entries:
        raise bad(
            file, f"truncated or damaged: {lines} entries where {entries} are announced; write it again"
        )
    return found


def _numpy(file: Path) -> dict[str, object]:
    arrays = numpy_archive(file)
    if set(arrays) >= _SPARSE_KEYS:
        try:
            return {"": sparse.load_npz(BytesIO(file_bytes(file)))}
        except Exception as error:  # inconsistent arrays fail in ways of their own
            raise bad(file, f"no sparse matrix of SciPy ({error}); write it again with save_npz") from None
    return {key: value for key, value in arrays.items() if value.ndim == 2}


def _symmetric(file: Path, matrix: sparse.csc_array) -> sparse.csc_array:
    rows, columns = matrix.shape
    if rows != columns or rows == 0:
        raise bad(file, f"the matrix is {rows} x {columns}; a structure's is square")
    size = np.sqrt(np.abs(matrix.diagonal()))
    uneven = sparse.coo_array(abs(matrix - matrix.T))
    if uneven.nnz:
        i, j = uneven.coords
        # A term beside a zero on the diagonal has no scale but its own.
        scale = np.maximum(size[i] * size[j], np.finfo(float).tiny)
        worst = int(np.argmax(uneven.data / scale))
        if uneven.data[worst] > _UNEVEN * scale[worst]:
            i, j = sorted((int(i[worst]), int(j[worst])))
            values = f"{matrix[i, j]:g} and {matrix[j, i]:g}"
            raise bad(
                file,
                f"not symmetric: the terms ({i + 1}, {j + 1}) and ({j + 1}, {i + 1}) are {values}; export both "
                "triangles of a conservative structure",
            )
    return sparse.csc_array((matrix + matrix.T) / 2)


def read_dofs(file: Path) -> tuple[str, ...]:
    """Names of degrees of freedom in the order of rows: a CSV with the columns grid and component, or one name a line.

    Raises
    ------
    StudyError
        For a file that cannot be read, another header, or a name that stands twice.
    """
    if file.suffix.lower() == ".csv":
        first, header, rows = table_rows(file)
        if header != ["grid", "component"]:
            raise bad(file, f"the header is {quote(','.join(header))}; write grid,component", first)
        cells = [(line, dof_name(file, grid, component, line)) for line, (grid, component) in rows]
    else:
        lines = ((k, line.strip()) for k, line in enumerate(text_lines(file), 1))
        cells = [(k, split_dof(file, line, k)) for k, line in lines if line and not line.startswith("#")]
    if not cells:
        raise bad(file, "the file names no degree of freedom; give one for each row of the matrices")
    return unique_dofs(file, [name for _, name in cells], [line for line, _ in cells])
