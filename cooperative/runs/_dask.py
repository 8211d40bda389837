"""The executor that runs samples on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

from jaxmpm.support.text import short, shown

ANSWER_TIMEOUT = 10
"""Seconds for a Dask scheduler to answer."""


def dask_executor(client: object) -> Callable[[], Executor]:
    """Makes the executor that runs samples on a Dask cluster, for `campaign.run(..., executor=...)`.

    Dask itself runs the sample of a dead worker again, on another one.

    Args:
        client: a `distributed.Client`, which stays open, or the address of a scheduler, "tcp://host:8786".

    Raises:
        ValueError: the extra `dask` is not installed.
    """
    try:
        import distributed.cfexecutor
    except ImportError as error:
        raise ValueError("Dask is not installed: pip install distributed") from error

    class OnCluster(distributed.cfexecutor.ClientExecutor):
        """As `concurrent.futures` knows executors."""

        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            super().shutdown(wait=not cancel_futures)
            if self._client is not client:
                self._client.close()

    def make() -> Executor:
        if not isinstance(client, str):
            return OnCluster(client, pure=False)
        try:
            if not client.strip():
                raise ValueError("it is empty")
            return OnCluster(distributed.Client(client, timeout=ANSWER_TIMEOUT, set_as_default=False), pure=False)
        except (OSError, ValueError, TypeError, KeyError) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(
                f"no Dask scheduler answers at {shown(client)} ({short(why, 400)}): give the address that it prints "
                "when it starts, for example tcp://host:8786"
            ) from error

    return make
