"""Settings: environment variables ``REVISIT_*``, read once into a frozen object."""

import base64
import binascii
import difflib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from schemas.errors import SetupError

MEGA = 1_000_000

LARGEST = 1e9
"""Of settings that are numbers with decimals: seconds, megabytes, megapixels."""

SECRET_BYTES = 16
"""Of the shortest secret that webhooks are signed with."""

IMAGES_ADDRESS = (
    r"s3://(?P<bucket>[a-z0-9][a-z0-9.-]{1,61}[a-z0-9])(?:/(?P<prefix>[A-Za-z0-9._-]+(?:/[A-Za-z0-9._-]+)*))?/?"
)
"""Address of images in an S3-compatible store."""

_ORIGIN = r"https?://[^\s/?#@*]+"  # as browsers write it: no path, and no slash at its end


def _reachable(address: str) -> str:
    """An address whose host may exist; raises ValueError where no connection could be tried, in words."""
    try:
        to = urlsplit(address)
        port = to.port
    except ValueError as error:  # an IPv6 address without its end, a port that is no number or too large
        why, _, _ = str(error).partition(" as ")  # behind it stands the port, which may be half of a password
        raise ValueError(f"has no usable host and port: {why}") from None
    try:
        (to.hostname or ".").encode("idna")
    except UnicodeError:
        raise ValueError("has a host with an empty part, or one of more than 63 letters") from None
    if port == 0:
        raise ValueError("has the port 0, at which nobody listens")
    return address


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


class Settings(BaseSettings):
    """All settings; docs/settings.md documents them."""

    model_config = SettingsConfigDict(env_prefix="REVISIT_", frozen=True, extra="forbid")

    data: Path = Field(Path("data"), description="Folder of the database and the images.")
    database: str | None = Field(None, description="SQLAlchemy URL; default is SQLite in the data folder.")
    images: str | None = Field(
        None, description="Where images lie: s3://bucket/prefix; default is the folder `pictures` of the data folder."
    )
    index: Literal["faiss", "pgvector", "pgvector-hnsw"] = Field(
        "faiss", description="Where vectors are searched: faiss (in memory), pgvector or pgvector-hnsw (PostgreSQL)."
    )
    host: str = Field("127.0.0.1", description="Address that `serve` listens on.")
    port: int = Field(8000, ge=0, le=65535, description="Port that `serve` listens on; 0 picks a free one.")
    open: bool = Field(False, description="Allow an address other than loopback although anybody may then call.")
    cors: str | None = Field(
        None, description="Origins whose pages may call the service, with commas between; * for any."
    )
    first_key: bool = Field(
        False, description="Make an admin key and print it once where others may reach a service without keys."
    )
    encoder: Literal["compact", "compact-open", "color", "lseg"] = Field(
        "compact", description="Encoder that describes images: compact, compact-open, color or lseg."
    )
    weights: Path | None = Field(None, description="Weights file of the encoder `lseg`.")
    bpe: Path | None = Field(None, description="CLIP's byte-pair vocabulary, for the encoder `lseg`.")
    lseg_mode: Literal["windows", "single"] = Field(
        "windows", description="How the encoder `lseg` covers an image: windows or single."
    )
    encoder_url: str | None = Field(
        None, description="Shared encoder that images are sent to: http://encoder:8100; default is one in the process."
    )
    encoder_key: SecretStr | None = Field(
        None, description="Key of the shared encoder: it asks for it, and a service sends it."
    )
    device: str = Field("cpu", description="Device of the network: cpu, cuda, cuda:1, ...")
    preset: str = Field("default", description="Preset of maps made without one: default, paper or code-words.")
    threads: int = Field(0, ge=0, le=256, description="Threads of the network; 0 takes one for each usable core.")
    batch: int = Field(0, ge=0, le=256, description="Images encoded together; 0: 1 on a CPU, 8 on a GPU.")
    inline_worker: bool = Field(True, description="Describe enrolled images inside `serve`.")
    compare: bool = Field(True, description="Compare the views of each map with one another in the background.")
    lease_s: float = Field(
        10, gt=0, description="Seconds without a sign of life that end a worker's claims; the same in all processes."
    )
    wait: float = Field(30, ge=0, description="Seconds that an enrolment waits at most for its description.")
    reserve_mb: float = Field(64, ge=0, description="Disk space kept for deletions, in 10^6 bytes; 0 keeps none.")
    max_body_mb: float = Field(25, gt=0, description="Largest request body, in 10^6 bytes.")
    bodies_mb: float = Field(
        256, gt=0, description="Memory for request bodies together, and as much for answers, in 10^6 bytes."
    )
    pixels_mb: float = Field(256, gt=0, description="Memory for decoded images that wait, in 10^6 bytes.")
    max_import_mb: float = Field(4000, gt=0, description="Largest recording that is imported, in 10^6 bytes.")
    body_s: float = Field(30, gt=0, description="Seconds for a body to arrive, and one more for each 50 kB of it.")
    head_s: float = Field(10, gt=0, description="Seconds for the headers of a request to arrive.")
    connections: int = Field(512, ge=1, description="Connections that are served at once; more are refused with 503.")
    grace_s: float = Field(20, gt=0, description="Seconds that requests under way may take when `serve` is stopped.")
    max_megapixels: float = Field(50, gt=0, description="Largest image, in 10^6 pixels; a side has at most 65,500.")
    decoders: int = Field(2, ge=0, le=64, description="Processes that decode images; 0 decodes inside the service.")
    decode_s: float = Field(20, ge=1, description="Seconds for decoding one image, and for it to wait for a decoder.")
    queue: int = Field(1000, ge=1, description="Enrolments that may wait before more are refused with 429.")
    queries: int = Field(32, ge=1, description="Queries that may wait before more are refused with 429.")
    explanations: int = Field(
        200,
        ge=0,
        description="Latest explained queries that are kept for drawing; 0: none, and answers link no drawing.",
    )
    limit_requests: int = Field(0, ge=0, description="Requests a minute of each key, or address without keys; 0: any.")
    limit_images: int = Field(0, ge=0, description="Images a minute of each key, or address without keys; 0: any.")
    limit_mb: float = Field(0, ge=0, description="10^6 bytes a minute of each key, or address without keys; 0: any.")
    limit_all_requests: int = Field(0, ge=0, description="Requests a minute of all callers together; 0: any.")
    limit_all_images: int = Field(0, ge=0, description="Images a minute of all callers together; 0: any.")
    limit_all_mb: float = Field(0, ge=0, description="10^6 bytes a minute of all callers together; 0: any.")
    log: Literal["text", "json"] = Field("text", description="Format of log lines: text or json.")
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Least level of log lines: debug, info, warning or error."
    )
    slow_s: float = Field(5, gt=0, description="Seconds after which a request is logged as slow.")
    traces: bool = Field(False, description="Send OpenTelemetry traces, as the variables OTEL_* say.")
    webhook: str | None = Field(None, description="Address that what queries found is sent to, as webhooks.")
    webhook_secret: SecretStr | None = Field(
        None, description="Secret that webhooks are signed with: `whsec_` and base64, or any text."
    )
    webhook_events: str = Field(
        "matched,no_match,look-alike", description="What is sent, with commas between: matched, no_match, look-alike."
    )
    mqtt: str | None = Field(None, description="Broker that what queries found is published to: mqtt://user@host:1883.")
    mqtt_password: SecretStr | None = Field(None, description="Password of the user in REVISIT_MQTT.")
    mqtt_topic: str = Field("revisit", description="First levels of the topics that are published.")
    url: str = Field("http://127.0.0.1:8000", description="URL of the service that the command line calls.")
    key: SecretStr | None = Field(None, description="Key that the command line sends; a service does not read it.")

    @field_validator("data", mode="before")
    @classmethod
    def _named(cls, folder: object) -> object:
        if isinstance(folder, str) and not folder.strip():
            raise ValueError("is empty; name a folder, or leave it out for `data`")
        return folder

    @field_validator("*")
    @classmethod
    def _finite(cls, value: object) -> object:
        if isinstance(value, float) and value > LARGEST:
            raise ValueError(f"is too large; at most {LARGEST:,.0f} is taken")
        return value

    @field_validator("images")
    @classmethod
    def _address(cls, text: str | None) -> str | None:
        if text is not None and not re.fullmatch(IMAGES_ADDRESS, text):
            raise ValueError("is no address such as s3://bucket/prefix; leave it out for the folder `pictures`")
        return text

    @field_validator("cors")
    @classmethod
    def _origins(cls, text: str | None) -> str | None:
        for origin in _listed(text or ""):
            if origin != "*" and not re.fullmatch(_ORIGIN, origin):
                raise ValueError(f"{origin!r} is no origin such as https://museum.example or http://localhost:5173")
        return text

    @field_validator("webhook")
    @classmethod
    def _receiver(cls, text: str | None) -> str | None:
        if text is not None and not re.fullmatch(r"https?://[^\s/?#@]+([/?][^\s#]*)?", text):
            raise ValueError("is no address such as https://app.example/hooks/revisit")
        return None if text is None else _reachable(text)

    @field_validator("encoder_url")
    @classmethod
    def _encoder(cls, text: str | None) -> str | None:
        if text is not None and not re.fullmatch(r"https?://[^\s/?#@]+(/[^\s?#]*)?", text):
            raise ValueError("is no address such as http://encoder:8100 (a key: REVISIT_ENCODER_KEY)")
        return None if text is None else _reachable(text)

    @field_validator("encoder_key")
    @classmethod
    def _encoder_key(cls, key: SecretStr | None) -> SecretStr | None:
        if key is not None and not re.fullmatch(r"[!-~]{16,}", key.get_secret_value()):
            raise ValueError("needs 16 visible ASCII characters or more, such as `openssl rand -hex 32` gives")
        return key

    @field_validator("mqtt")
    @classmethod
    def _broker(cls, text: str | None) -> str | None:
        if text is not None and not re.fullmatch(r"mqtts?://([^\s:/?#@]+@)?[A-Za-z0-9.-]+(:[0-9]{1,5})?", text):
            raise ValueError(
                "is no address such as mqtt://robot@broker.example:1883 (a password: REVISIT_MQTT_PASSWORD)"
            )
        return None if text is None else _reachable(text)

    @field_validator("mqtt_topic")
    @classmethod
    def _topic(cls, text: str) -> str:
        if not re.fullmatch(r"[^\s/+#$\x00]+(/[^\s/+#$\x00]+)*", text):
            raise ValueError("is no topic such as revisit or building/3: no +, #, $, blanks or empty levels")
        return text

    @field_validator("webhook_secret")
    @classmethod
    def _secret(cls, secret: SecretStr | None) -> SecretStr | None:
        text = "" if secret is None else secret.get_secret_value()
        try:
            key = base64.b64decode(text.removeprefix("whsec_"), validate=True) if text.startswith("whsec_") else text
        except binascii.Error:
            raise ValueError("is no base64 after whsec_") from None
        if secret is not None and len(key) < SECRET_BYTES:
            raise ValueError(f"is too short: {SECRET_BYTES} bytes are needed")
        return secret

    @field_validator("webhook_events")
    @classmethod
    def _events(cls, text: str) -> str:
        unknown = set(_listed(text)) - {"matched", "no_match", "look-alike"}
        if unknown or not _listed(text):
            raise ValueError("needs some of matched, no_match, look-alike, with commas between")
        return text

    @property
    def webhook_kinds(self) -> tuple[str, ...]:
        """Which events webhooks tell."""
        return _listed(self.webhook_events)

    @property
    def query_pixel_bytes(self) -> int:
        """Bytes of decoded images of queries that wait for the encoder: half of ``pixels_mb``."""
        return round(self.pixels_mb * MEGA / 2)

    @property
    def enrolment_pixel_bytes(self) -> int:
        """Bytes of decoded images that are being stored: an eighth of ``pixels_mb``."""
        return round(self.pixels_mb * MEGA / 8)

    @property
    def handed_on_pixel_bytes(self) -> int:
        """Bytes of decoded images that are stored and wait for their description: the rest of ``pixels_mb``."""
        return round(self.pixels_mb * MEGA * 3 / 8)

    @property
    def cors_origins(self) -> tuple[str, ...]:
        """Origins whose pages may call the service."""
        return _listed(self.cors or "")

    @property
    def database_url(self) -> str:
        """SQLAlchemy URL of the database."""
        return self.database or f"sqlite:///{self.data / 'revisit.db'}"


def without_password(address: str) -> str:
    """An address as messages show it: without what stands before its host, a user and a password maybe."""
    return re.sub(r"^([a-z][a-z0-9+.-]*://)?.*@", r"\1***@", address, flags=re.IGNORECASE | re.DOTALL)


def refuse_unknown(environment: Mapping[str, str]) -> None:
    """Raise SetupError for a ``REVISIT_*`` variable that does not exist, with the nearest name that does."""
    names = {f"REVISIT_{name}".upper() for name in Settings.model_fields}
    for name in sorted({name for name in environment if name.startswith("REVISIT_")} - names):
        near = difflib.get_close_matches(name, sorted(names), n=1, cutoff=0.0)
        raise SetupError(f"unknown setting {name}; did you mean {near[0]}? docs/settings.md lists all of them")


def read_settings(environment: Mapping[str, str] | None = None, **overrides: object) -> Settings:
    """Settings from ``REVISIT_*`` variables; `overrides` (from flags) win.

    Raises
    ------
    SetupError
        A variable is unknown (the nearest name is offered) or has a value that cannot be used.
    """
    env = os.environ if environment is None else environment
    refuse_unknown(env)
    ours = {k: v for k, v in env.items() if k.startswith("REVISIT_")}
    values: dict[str, object] = {k.removeprefix("REVISIT_").lower(): v for k, v in ours.items()}
    values.update({k: v for k, v in overrides.items() if v is not None})
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = f"REVISIT_{'_'.join(map(str, first['loc']))}".upper()
        secret = "Secret" in str(Settings.model_fields[str(first["loc"][0])].annotation)
        value = first["input"]
        shown = "***" if secret else repr(without_password(value) if isinstance(value, str) else value)
        raise SetupError(f"{name}={shown}: {first['msg'].removeprefix('Value error, ')}") from None
