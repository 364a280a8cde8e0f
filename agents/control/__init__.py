"""The paper's mathematics as pure functions: no clock, bus, file, log or randomness inside.

What a controller works out in each cycle is plain Python over numbers and short sequences. An agent
calls these functions; a study compiles the same functions with Numba (`studies.arrays`). So
that both give the same bits, sums run in the order of the children, and "no measurement" is NaN.
What is worked out once from history (correlation, clusters) uses numpy.

S. A. Julien, A. Sajadi, B.-M. Hodge, "Hierarchical Control of Utility-Scale Solar PV Plants for
Mitigation of Generation Variability and Ancillary Service Provision", section II.
"""
