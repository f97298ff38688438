"""Before numpy is imported: threads and kernels as the commands have them, so that bits are the same."""

from __future__ import annotations

from experiments.support.threads import limit_threads

limit_threads()
