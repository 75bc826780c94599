"""What the libraries need of the processor, looked at before they are imported: they would end the process."""

import platform
from pathlib import Path

from app.cli.output import Failure

NEEDED = ("cx16", "lahf_lm", "popcnt", "sse4_1", "sse4_2", "ssse3")
"""x86-64-v2 (System V ABI for x86-64, 3.1.1) as Linux names it: what NumPy's wheels are compiled for."""

CPUINFO = Path("/proc/cpuinfo")


def missing_instructions(cpuinfo: str) -> list[str]:
    """Instruction sets of `NEEDED` that a processor lacks; none where the text lists no flags (another system)."""
    for line in cpuinfo.splitlines():
        name, _, flags = line.partition(":")
        if name.strip() == "flags":
            return sorted(set(NEEDED) - set(flags.split()))
    return []


def check_processor() -> None:
    """Raise Failure where the service would end by SIGILL without a word."""
    if platform.machine() not in ("x86_64", "AMD64") or not CPUINFO.is_file():
        return
    if missing := missing_instructions(CPUINFO.read_text(errors="replace")):
        raise Failure(
            f"this processor lacks {', '.join(missing)}; the service needs x86-64-v2 (Intel since 2009, AMD since "
            "2011). In a virtual machine, choose a processor type that passes them on, such as `host`"
        )
