"""A certificate of a test's own, for ``localhost``."""

import shutil
import subprocess
from pathlib import Path

import pytest


def self_signed(folder: Path) -> tuple[Path, Path]:
    """Files of a key and of the certificate that it signed itself; skips the test without openssl."""
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    if shutil.which("openssl") is None:
        pytest.skip("TLS IS NOT TRIED: there is no openssl to make a certificate with")
    making = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    naming = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    to = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run([*making, *naming, *to], check=True, capture_output=True)
    return key, certificate
