"""The modelled image of a smeared target: its parameters, where a fit begins, and how far it can be trusted."""
