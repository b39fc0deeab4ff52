"""Light stages: pure functions over per-texel arrays, and the runner that orders, skips and times them."""
