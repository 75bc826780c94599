"""The use-cases: enrol, query, and look after maps, views and jobs. Synchronous; ports in, records out."""
