"""Runs migrations on the connection that `worker.stores.migrating` hands over, in its transaction."""

from alembic import context

from worker.stores.tables import METADATA

context.configure(connection=context.config.attributes["connection"], target_metadata=METADATA)
context.run_migrations()
