"""Runs migrations on the connection that `worker.storage.migrating` hands over, in its transaction."""

from alembic import context

from worker.storage.tables import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
context.run_migrations()
