"""The page that `dashpot serve` shows: an engine behind a protocol in JSON, sessions on disk, and the page itself."""
