"""One mechanism a file. A new file here is found by the catalogue, fitted, tried in diagnoses and reported."""
