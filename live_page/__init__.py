"""The page that shows a run in a browser, while it goes on or from its recording.

Here belong the server and the scripts of the page; what they show is computed in `results` and
`recordings`. It imports all but `studies` and `heliarch`. Begin with `server.py` and
`plant_state.py`, in the browser with `static/app.js`.
"""
