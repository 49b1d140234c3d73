"""Results as pages that open in a browser, offline: text in, text out; no file is read but the package's own."""
