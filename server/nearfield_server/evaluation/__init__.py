"""`nearfield evaluate`: a bundle with known truth in, a report of what clients would see out."""
