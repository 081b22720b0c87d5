"""Measurement models: from sim channels to what only the real robot measures.

`models` the network · `fit` training it on recordings · `checks` how far it can be trusted ·
`transform` the model inside a training env · `fit_command` all of it on one store (`hts fit`).
"""
