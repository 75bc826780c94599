"""Write requirements.lock and requirements-dev.lock: ``python3 .ci/lock.py``, or with ``--upgrade`` for newer versions.

Needs uv 0.13 or newer (``pip install uv``), which resolves pyproject.toml for every platform and Python from 3.11 on,
keeps the versions that are pinned already, and lists the SHA-256 of every file of each. The launcher installs both
files with ``--require-hashes --no-deps``: what is not listed here is not installed. torch is the one package that uv
does not write; docs/decisions/0010-locked-with-hashes.md says why.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

TORCH = "2.13.0"
"""Not the newest: the version that weights and figures were made with. Raise it together with the benchmarks."""

CPU_LINUX = {
    "cp311-cp311-manylinux_2_28_aarch64": "84453b69508ec79902f899c5ed9495acb9e2bbe9fda5f1d5d6f19e3c3842e1a7",
    "cp311-cp311-manylinux_2_28_x86_64": "6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b",
    "cp312-cp312-manylinux_2_28_aarch64": "6f307c2c32d764ffc6ff6893b801fad6d4752f3e67966cb8abf1843427c02604",
    "cp312-cp312-manylinux_2_28_x86_64": "4ca4a9394b0c771238a4f73590fdbbc4debad85ed0fa63d026ae1b085da7d6e2",
    "cp313-cp313-manylinux_2_28_aarch64": "0b8f7d0423027ae8b90c7977c627f3379f325363a08224dffad9b4b2d684a83d",
    "cp313-cp313-manylinux_2_28_x86_64": "3fbf9c9d1f3c10c2d59d04aca426dee9ccc6ceb32d255c61e93acc3b4f75fae6",
    "cp314-cp314-manylinux_2_28_aarch64": "ca021f9eb2f8345c83fa03e3a04587308afb8df71bd472670b3ece00df58621c",
    "cp314-cp314-manylinux_2_28_x86_64": "d20fa53ee744502fa4c69818a720b05ca0d37abd055d4f6e66cae155114bc691",
}
"""SHA-256 of the wheels torch-2.13.0+cpu of the PyTorch project's CPU index (PyPI has no local versions)."""

CPU_MACOS = {
    "cp311-cp311-macosx_14_0_arm64": "e76f9bcecc52b8ff711239a2f7547d5353df95878ab232f0773c1d95928b92f8",
    "cp312-cp312-macosx_14_0_arm64": "2fe228aba290d14b9f31b049be550dbd469c3fd3013d7a19705b30454da97027",
    "cp313-cp313-macosx_14_0_arm64": "33449899ce5496c1b84b4853179d94fd102028ae1407314d9fb956bb79e70d09",
    "cp314-cp314-macosx_14_0_arm64": "d849b390e07d8d333ce8ecaf91b273c656c598379a19c9acf1318a883f6b391c",
}
"""SHA-256 of the wheels torch-2.13.0 for macOS on PyPI, which are CPU builds; those for Linux there are CUDA's."""

CUDA = """
cuda-bindings
cuda-toolkit
nvidia-cudnn-cu13
nvidia-cusparselt-cu13
nvidia-nccl-cu13
nvidia-nvshmem-cu13
triton
"""
"""What torch's metadata on PyPI asks for on Linux and its CPU build does not need."""


def compiled(output: str, *options: str) -> Path:
    """Have uv resolve pyproject.toml into a file of the checkout."""
    with tempfile.TemporaryDirectory() as folder:
        excluded, held = Path(folder) / "excluded.txt", Path(folder) / "held.txt"
        excluded.write_text(CUDA)
        held.write_text(f"torch=={TORCH}\n")
        command = ["uv", "pip", "compile", "--quiet", "--no-config", "--universal", "--python-version=3.11"]
        command += ["--generate-hashes", "--no-annotate", "--custom-compile-command=python3 .ci/lock.py"]
        command += [f"--excludes={excluded}", f"--constraints={held}", "--no-emit-package=torch"]
        command += ["pyproject.toml", f"--output-file={output}", *options, *sys.argv[1:]]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return ROOT / output


def torch(version: str, marker: str, hashes: dict[str, str]) -> str:
    """A pin of torch as uv writes pins."""
    lines = [f"torch=={version} ; {marker}", *(f"    --hash=sha256:{value}" for value in sorted(hashes.values()))]
    return " \\\n".join(lines) + "\n"


def main() -> None:
    """First what the service needs, then what else its checks need."""
    runtime = compiled("requirements.lock")
    names = re.findall(r"^([\w.-]+)==", runtime.read_text(), re.MULTILINE)
    known = [f"--no-emit-package={name}" for name in names]
    extras = [f"--extra={name}" for name in ("dev", "lab", "lseg")]
    compiled("requirements-dev.lock", f"--constraints={runtime}", *extras, *known)
    with runtime.open("a") as lock:
        lock.write(torch(TORCH, "sys_platform == 'darwin'", CPU_MACOS))
        lock.write(torch(f"{TORCH}+cpu", "sys_platform != 'darwin'", CPU_LINUX))


if __name__ == "__main__":
    main()
