"""Jobs of benches and campaigns: run by processes here or on a cluster; their results last."""
