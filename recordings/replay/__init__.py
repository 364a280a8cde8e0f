"""`heliarch replay`: a recording back onto the bus, with or without live agents among it."""
