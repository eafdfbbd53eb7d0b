"""Continuation in contact stiffness: stiff contacts are solved from the solution of softer ones.

The schedule says which stiffnesses (:mod:`octo.continuation.schedule`), the run goes from one to
the next (:mod:`octo.continuation.run`), and a member is what is known of one start on the way
(:mod:`octo.continuation.member`).
"""
