"""The commands of the `nearfield` command line; each module is one command."""
