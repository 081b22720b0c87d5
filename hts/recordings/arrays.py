"""Arrays of a recording as Zarr 3 on disk."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

# Longest chunk in samples. Any recording of a day at 10 Hz or of six hours at 50 Hz is a single chunk.
CHUNK_SAMPLES = 1 << 20


def write_group(folder: Path, attributes: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Write one Zarr 3 group into an existing folder.

    attributes: of the group; its `arrays` entry gives each array's own. arrays: name -> (T, …). Raises OSError;
    by then nothing is still being written into the folder.
    """
    try:
        _write(folder, attributes, arrays)
    except OSError:
        from zarr.core.sync import sync

        sync(_other_writes_end())
        raise


def _write(folder: Path, attributes: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    import zarr  # 0.4 s to import: only when something is stored

    # Not mode "w": that would remove the folder and make another, and the writer's lock is on this one.
    group = zarr.create_group(str(folder), zarr_format=3, attributes=dict(attributes))
    for name, values in arrays.items():
        plain = np.ascontiguousarray(values)
        array = group.create_array(
            name,
            shape=plain.shape,
            dtype=plain.dtype,
            chunks=(min(len(plain), CHUNK_SAMPLES), *plain.shape[1:]),
            compressors=None,
            dimension_names=["time", *[None] * (plain.ndim - 1)],
            # zarr leaves out chunks that are all zero, but here a missing chunk is to mean damage.
            config={"write_empty_chunks": True},
            attributes={key: value for key, value in attributes["arrays"][name].items() if key != "shape"},
        )
        array[...] = plain


async def _other_writes_end() -> None:
    """zarr writes several files side by side and raises at the first that fails, while the others go on."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    await asyncio.gather(*others, return_exceptions=True)


def read_array(folder: Path, shape: tuple[int, ...]) -> np.ndarray:
    """The decoded array of that shape. Raises OSError, ValueError, KeyError, … if it is damaged;
    the caller hashes the result."""
    metadata = json.loads((folder / "zarr.json").read_bytes())
    found, chunk = metadata["shape"], metadata["chunk_grid"]["configuration"]["chunk_shape"]
    # Before zarr makes room for it: a file of a few bytes can ask for any amount of memory.
    if found != list(shape) or len(chunk) != len(shape) or any(a > b for a, b in zip(chunk, shape, strict=True)):
        raise ValueError(f"its shape is {found!s:.60} in chunks of {chunk!s:.60}")
    if metadata["data_type"] not in ("float32", "float64"):
        raise ValueError(f"its data type is {metadata['data_type']!r:.40}")
    plain = _plain_chunk(folder, metadata)
    if plain is not None:
        return plain
    import zarr

    return np.asarray(zarr.open_array(str(folder), mode="r")[...])


def _plain_chunk(folder: Path, metadata: Mapping[str, Any]) -> np.ndarray | None:
    """The samples, if the array is one uncompressed little-endian chunk; None if it needs zarr to decode.

    That is how `write_group` stores nearly everything. zarr takes 2.4 ms per array (3.1.6), which for a run's
    few dozen recordings is longer than reading the samples.
    """
    shape = tuple(metadata["shape"])
    little = [{"name": "bytes", "configuration": {"endian": "little"}}]
    if (
        metadata["codecs"] != little
        or metadata["data_type"] not in ("float32", "float64")
        or tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]) != shape
        or metadata["chunk_key_encoding"] != {"name": "default", "configuration": {"separator": "/"}}
        or metadata.get("storage_transformers")
    ):
        return None
    file = folder.joinpath("c", *["0"] * len(shape))
    values = np.fromfile(file, dtype=np.dtype(metadata["data_type"]).newbyteorder("<"))
    if len(values) != math.prod(shape):
        raise ValueError(f"{file.relative_to(folder)} holds {len(values)} numbers, not {math.prod(shape)}")
    return values.reshape(shape).astype(values.dtype.newbyteorder("="), copy=False)
