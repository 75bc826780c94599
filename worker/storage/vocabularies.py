"""Vocabularies that were trained on maps, by the SHA-256 of their safetensors."""

import hashlib

import sqlalchemy as sa

from schemas.errors import Damaged, NotFound
from worker.storage.part import Part
from worker.storage.tables import VOCABULARIES


def keep_vocabulary(connection: sa.Connection, digest: str, tensors: bytes) -> None:
    """Store safetensors bytes under their SHA-256; a second time does nothing."""
    if connection.scalar(sa.select(VOCABULARIES.c.digest).where(VOCABULARIES.c.digest == digest)) is None:
        connection.execute(sa.insert(VOCABULARIES).values(digest=digest, tensors=bytes(tensors)))


class Vocabularies(Part):
    """Trained vocabularies by digest."""

    def keep(self, digest: str, tensors: bytes) -> None:
        """As `keep_vocabulary`, for tests and studies: without a recipe that names it, it is pruned soon."""
        with self._database.writing() as connection:
            keep_vocabulary(connection, digest, tensors)

    def get(self, digest: str) -> bytes:
        """The safetensors bytes of a vocabulary; raises NotFound."""
        with self._database.reading() as connection:
            tensors = connection.scalar(sa.select(VOCABULARIES.c.tensors).where(VOCABULARIES.c.digest == digest))
        if tensors is None:
            raise NotFound("vocabulary", digest)
        if hashlib.sha256(tensors).hexdigest() != digest:
            raise Damaged(f"the stored vocabulary {digest} is damaged; train the map another one, or restore a backup")
        return bytes(tensors)
