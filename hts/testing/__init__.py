"""The kit for plugin authors: a conformance check, packages to start from, worlds with known answers.

`hts check PACKAGE` and `hts new` are made of it, and the project's own plugins are tested with it.
"""
