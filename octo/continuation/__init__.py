"""Continuation in contact stiffness: stiff contacts are solved from the solution of softer ones."""
