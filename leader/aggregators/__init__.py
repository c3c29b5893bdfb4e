"""How one model is made of many: the base class of every aggregation rule, and a rule a file."""
