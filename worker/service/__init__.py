"""The use-cases: enrol, query, manage maps, views and jobs. Synchronous; parts of the store in, records out."""
