# SPDX-License-Identifier: Apache-2.0
"""Import a site from a map or a scene graph, draw it, and compare two versions."""
