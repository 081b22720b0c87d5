"""Measurement models: from sim channels to what only the real robot measures.

`lstm`, `linear`, `ensemble` the models that come with hts · `torch_model`, `data` what others can build on ·
`split`, `scoring`, `baseline`, `checks` how far one can be trusted · `transform` the model inside a training env,
`pessimism` its doubt as reward · `files` models on disk · `fit_command` all of it on one store (`hts fit`).
"""
