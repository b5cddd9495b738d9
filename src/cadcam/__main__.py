"""`python -m cadcam` is `cadcam`."""

from cadcam.cli.main import main

raise SystemExit(main())
