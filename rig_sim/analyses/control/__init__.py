"""Control of a mass on a belt: shaker feedback that quenches it, and locking a driven mass onto an unstable orbit."""
