"""Pictures made by the workers of a Dask cluster, to the last bit as by one machine.

places opens the cluster that a user names; sampler hands out units of a picture, and adds up what
comes back; worker is what runs elsewhere; scenes is how a scene gets there.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .sampler import Workers

log = logging.getLogger("parhelion")

# Parts that failed for good of which each is told
_TOLD = 10


@contextmanager
def sampler_of(cluster: Any, threads: int, *picture: Any, **how: Any) -> Iterator[Workers]:
    """What has a cluster render a film; see places.opened() and sampler.Workers.

    What failed for good is told when the block ends.
    """
    from .places import opened
    from .sampler import Workers

    with opened(cluster, threads) as place:
        workers = Workers(place, *picture, **how)
        try:
            yield workers
        finally:
            workers.close()
            for failure in workers.failures[:_TOLD]:
                log.error("%s", failure)
            if len(workers.failures) > _TOLD:
                log.error("and %d parts more failed", len(workers.failures) - _TOLD)
