"""Importers of public data sets, a file each; `registry` lists them and says what an importer is."""
