"""The HTTP interface: routes, parameters, presenters, problems, middleware, metrics."""
