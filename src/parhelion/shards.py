"""Which part of one picture each of many machines renders that know nothing of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments
from .errors import SceneError, option

if TYPE_CHECKING:
    from numpy.typing import NDArray

# What files of shards are called
ENDING = ".part"
# More machines than there are
_MOST = 1 << 20
# 1 over the golden ratio: multiples of it lie as evenly in [0, 1) as those of any number
_GOLDEN = 0.6180339887498949


def checked_shard(shard: Any) -> tuple[int, int]:
    """Which shard, from 1, and of how many. Raises SceneError for what is none."""
    try:
        index, count = shard
    except (TypeError, ValueError):
        raise SceneError(
            f"{option('shard')} is {shard!r}; must be two numbers, (1, 4) for the first of four"
        ) from None
    count = arguments.whole(f"{option('shard')}: the number of shards", count, 1, _MOST)
    return arguments.whole(f"{option('shard')}: the shard", index, 1, count), count


def blocks_of(
    shard: tuple[int, int], width: int, height: int, reuse_paths: bool = False
) -> NDArray[np.bool_]:
    """Which blocks of a picture a shard has, (blocks down, blocks across).

    Of every `count` squares in a row each shard has one, each time another, so that all have as
    much to do wherever in the picture there is much. A square is a block, or, with reuse_paths,
    the region whose pixels share paths. Raises SceneError for more shards than squares.
    """
    from . import _core

    index, count = shard
    block: int = _core.block
    edge: int = _core.region if reuse_paths else block
    across, down = _along(width, edge), _along(height, edge)
    if count > across * down:
        raise SceneError(
            f"{option('shard')} {index}/{count}: a picture of {width}x{height} has"
            f" {across * down} squares of {edge}x{edge} pixels to share, and no more shards"
        )
    group, place = np.divmod(np.arange(across * down), count)
    turn = np.floor(group * _GOLDEN % 1.0 * count).astype(np.int64)
    own: NDArray[np.bool_] = ((place + turn) % count == index - 1).reshape(down, across)
    of_blocks = own.repeat(edge // block, axis=0).repeat(edge // block, axis=1)
    return of_blocks[: _along(height, block), : _along(width, block)]


def block_count(width: int, height: int) -> int:
    """How many blocks a picture has."""
    from . import _core

    return _along(width, _core.block) * _along(height, _core.block)


def _along(side: int, edge: int) -> int:
    return -(-side // edge)
