"""The paper's mathematics as pure functions: no clock, bus, file, log or randomness inside.

What a controller calculates in each cycle is plain Python over short sequences, with sums by
`math.fsum`: exactly rounded, so that a result does not depend on the processor or on the order of
the children. What is calculated once from history (correlation, clusters) uses numpy.

S. A. Julien, A. Sajadi, B.-M. Hodge, "Hierarchical Control of Utility-Scale Solar PV Plants for
Mitigation of Generation Variability and Ancillary Service Provision", section II.
"""
