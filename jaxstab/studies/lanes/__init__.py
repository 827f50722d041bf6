"""Ready-made cases computed in lanes, in which a new case follows one that is done."""
