"""What server and client must agree on: records, codecs and sessions. See SPEC.md and CONVENTIONS.md."""
