"""Pictures and pages that show an object, what was learned of it, and how sure that is."""
