"""Commands that show and export what there is."""
