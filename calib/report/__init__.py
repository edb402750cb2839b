"""The accuracy report: figures, sections, one self-contained HTML page.

It reads results and computes nothing. Three layers: `figures` draws one thing a function,
`sections` picks results and writes about them, `page` assembles a declared list of sections.
"""
