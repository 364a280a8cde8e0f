"""The page that shows a run in a browser, while it goes on or from its recording."""
