// The page of results: all captures are in it.
spaceView(document.getElementById("space"))(JSON.parse(document.getElementById("space-data").textContent));
