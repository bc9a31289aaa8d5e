"""By which commit something was worked out."""

import subprocess
from pathlib import Path


def commit() -> str:
    """As git describes the present one; unknown where there is no git, or no checkout."""
    call = ["git", "describe", "--always", "--dirty", "--abbrev=8"]
    try:
        here = Path(__file__).resolve().parent
        return subprocess.run(call, cwd=here, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
