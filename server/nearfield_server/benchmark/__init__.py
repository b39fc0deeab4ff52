"""`nearfield bench`: run time against error, next to the methods of the papers and to other renderers."""
